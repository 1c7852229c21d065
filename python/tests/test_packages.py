"""The version bounds of the required packages are correct."""

import importlib.metadata
import pathlib
import re

from packaging.requirements import Requirement

import resin_farm


def test_the_bounds_of_protobuf_are_those_of_the_generated_modules() -> None:
    """The modules run from the version of protobuf that generated them to the end of the next major one."""
    made = pathlib.Path(resin_farm.__file__).parent / "_wire" / "model_pb2.py"
    version = re.search(r"Protobuf Python Version: (\d+)\.(\d+)\.(\d+)", made.read_text(encoding="utf-8"))
    assert version is not None
    major, minor, patch = (int(number) for number in version.groups())
    needs = [Requirement(line) for line in importlib.metadata.requires("resin-farm") or []]
    (protobuf,) = [need.specifier for need in needs if need.name == "protobuf"]
    assert protobuf.contains(f"{major}.{minor}.{patch}") and protobuf.contains(f"{major + 1}.99.0")
    assert not protobuf.contains(f"{major}.{minor - 1}.99") and not protobuf.contains(f"{major + 2}.0.0")
