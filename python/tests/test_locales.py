"""Text is UTF-8 in every locale."""

import os
import pathlib
import subprocess
import sys

import pytest

from conftest import WHITE

# Passes text through files, pipes and calls: names of materials from a file and a frame, and a message of farmctl.
PROGRAM = """
import pathlib, sys
import resin_farm

folder = pathlib.Path(sys.argv[1])
(material,) = resin_farm.read_measurements(folder / "measured.csv")
assert material.material == "wei\\u00df", ascii(material.material)
(again,) = resin_farm.Measurement.from_pandas(material.to_pandas())
assert again.material == "wei\\u00df", ascii(again.material)
try:
    resin_farm.read_measurements(folder / "bad.csv")
except resin_farm.InvalidArgument as error:
    assert "\\u00b5" in error.message, ascii(error.message)
else:
    raise AssertionError("a column of an unknown unit is read")
"""


@pytest.fixture(scope="module")
def latin_1(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The variables of a locale of ISO 8859-1, made for this test."""
    folder = tmp_path_factory.mktemp("locales")
    command = ["localedef", "-i", "en_US", "-f", "ISO-8859-1", str(folder / "en_US.ISO-8859-1")]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (FileNotFoundError, subprocess.CalledProcessError):
        pytest.skip("localedef cannot make a locale of ISO 8859-1")
    return {"LOCPATH": str(folder), "LC_ALL": "en_US.ISO-8859-1"}


def in_locale(tmp_path: pathlib.Path, variables: dict[str, str]) -> None:
    text = WHITE.read_text(encoding="utf-8").replace("white", "weiß")
    (tmp_path / "measured.csv").write_text(text, encoding="utf-8")
    (tmp_path / "bad.csv").write_text("material,channel,thickness_µ,value\nweiß,R,1,2\n", encoding="utf-8")
    as_they_are = {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    ran = subprocess.run(
        command, env=os.environ | as_they_are | variables, capture_output=True, encoding="utf-8", errors="replace"
    )
    assert ran.returncode == 0, ran.stderr


def test_text_is_utf_8_in_the_c_locale(tmp_path: pathlib.Path) -> None:
    in_locale(tmp_path, {"LC_ALL": "C"})


def test_text_is_utf_8_in_a_locale_of_iso_8859_1(tmp_path: pathlib.Path, latin_1: dict[str, str]) -> None:
    in_locale(tmp_path, latin_1)


def test_no_file_or_pipe_is_read_in_the_encoding_of_the_locale(tmp_path: pathlib.Path) -> None:
    code = (
        "import sys, warnings\n"
        'warnings.filterwarnings("error", category=EncodingWarning, module=r"resin_farm(\\.|$)")\n'
        "import resin_farm\n"
        "with resin_farm.Farm(sys.argv[1]) as farm:\n"
        "    farm.submit(resin_farm.Grid(sigma_t_per_mm=[4], albedo=[0.9], g=[0], thickness_mm=[1], walks=5000))\n"
        '    farm.dictionary("grid").to_xarray()\n'
    )
    command = [sys.executable, "-X", "warn_default_encoding", "-c", code, str(tmp_path / "data")]
    ran = subprocess.run(command, capture_output=True, encoding="utf-8")
    assert ran.returncode == 0, ran.stderr
