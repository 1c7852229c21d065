"""docs/python-api.md is what the docstrings are, and has all public names."""

import runpy

import resin_farm
from conftest import CHECKOUT

REFERENCE = runpy.run_path(str(CHECKOUT / "python" / "reference.py"))


def test_the_reference_is_up_to_date() -> None:
    """`python python/reference.py` writes it. A missing docstring, or an argument without a text, is an error there."""
    assert (CHECKOUT / "docs" / "python-api.md").read_text(encoding="utf-8") == REFERENCE["page"]()


def test_the_reference_has_all_public_names() -> None:
    names = [name for group in REFERENCE["GROUPS"].values() for name in group.split()]
    assert sorted(names) == sorted(resin_farm.__all__)
