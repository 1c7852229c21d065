"""The examples of the documents run, and print what these show; FARM_TEST_ACCEPT=1 writes what they print now."""

import contextlib
import difflib
import doctest
import io
import os
import pathlib
import re
import subprocess

import pytest

import resin_farm
from conftest import CHECKOUT, WHITE
from resin_farm._programs import program

BLOCK = re.compile(r"^```(\w*)([^\n]*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


def printed(source: str, mode: str, names: dict[str, object]) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as output:
        exec(compile(source, "document", mode), names)
    return output.getvalue()


def with_present_output(text: str, names: dict[str, object]) -> str:
    """The document with the output of its Python: in prompts, and in a block `text` next to one of `python`."""
    output = ""

    def present(block: re.Match[str]) -> str:
        nonlocal output
        language, rest, body = block.groups()
        if language == "text" and output:
            body = re.sub(r" +$", "", output, flags=re.MULTILINE)
        output = printed(body, "exec", names) if language == "python" else ""
        if language == "pycon":
            examples = doctest.DocTestParser().get_examples(body)
            assert examples
            body = "".join(f">>> {example.source}{printed(example.source, 'single', names)}" for example in examples)
        return f"```{language}{rest}\n{body}```"

    return BLOCK.sub(present, text)


def check(page: str, names: dict[str, object]) -> None:
    path = CHECKOUT / page
    text = path.read_text(encoding="utf-8")
    fresh = with_present_output(text, names)
    if os.environ.get("FARM_TEST_ACCEPT"):
        path.write_text(fresh, encoding="utf-8")
    else:
        lines = difflib.unified_diff(text.splitlines(), fresh.splitlines(), page, "present", n=0, lineterm="")
        difference = "\n".join(lines)
        assert not difference, f"FARM_TEST_ACCEPT=1 accepts the present output:\n{difference}"


def test_the_documents_show_what_their_lines_print(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(WHITE.parent)
    names: dict[str, object] = {}
    check("docs/python.md", names)
    farm = names["farm"]
    assert isinstance(farm, resin_farm.Farm)
    farm.close()
    subprocess.run([program("farmctl"), "export", "paper", "--npz", "paper.npz"], check=True, capture_output=True)
    check("docs/formats.md", {})
    check("python/README.md", {})


def test_other_output_than_the_documents_is_found() -> None:
    text = "```python\nprint(1 + 1)\n```\n\n```text\n3\n```\n\n```pycon\n>>> 1 + 2\n4\n```\n\n```text\nother\n```\n"
    assert with_present_output(text, {}) == text.replace("\n3\n", "\n2\n").replace("\n4\n", "\n3\n")
