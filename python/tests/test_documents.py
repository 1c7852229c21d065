"""The examples of docs/python.md run."""

import pathlib
import re

import pytest

import resin_farm
from conftest import CHECKOUT, GRID, WHITE


def test_the_lines_of_the_documents_run(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (CHECKOUT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) >= 8
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(WHITE.parent)
    # The paper's grid takes minutes in a debug build.
    (tmp_path / "paper.toml").write_text(GRID.to_toml(), encoding="utf-8")
    names: dict[str, object] = {}
    for block in blocks:
        if "Farm.connect(" in block:
            continue
        exec(block.replace("farm.submit()", 'farm.submit("paper.toml")'), names)
    farm = names["farm"]
    assert isinstance(farm, resin_farm.Farm)
    farm.close()
