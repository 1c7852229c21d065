"""The notebooks are stored with small outputs; python/check executes them."""

import json
import pathlib
from collections.abc import Iterator
from typing import Any

import pytest

from conftest import CHECKOUT

NOTEBOOKS = sorted((CHECKOUT / "python" / "notebooks").glob("*.ipynb"))
LARGEST = 150_000
ALLOWED = {"text/plain", "text/html", "image/png"}


def outputs(book: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for cell in book["cells"]:
        yield from cell.get("outputs", [])


def test_there_are_four() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["mitsuba", "paper", "planning", "scale_factor"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_executed(path: pathlib.Path) -> None:
    """`python python/store_notebooks.py` stores them: executed from the first cell to the last, with pictures."""
    assert path.stat().st_size <= LARGEST
    book = json.loads(path.read_text(encoding="utf-8"))
    code = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    kinds = {kind for output in outputs(book) for kind in output.get("data", {})}
    assert "image/png" in kinds and kinds <= ALLOWED
    for output in outputs(book):
        assert output["output_type"] != "error" and output.get("name") != "stderr"
        assert "<script" not in "".join(output.get("data", {}).get("text/html", ""))
