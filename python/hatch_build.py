"""Adds the three programs and the modules of the gRPC interface to a wheel.

`cargo build --release` builds the programs, unless FARM_PROGRAMS is the folder where they are. The wheel runs where the
programs run: with any Python, and with a C library at least as new as the newest symbol that they use.
"""

import os
import pathlib
import platform
import re
import shutil
import subprocess
import sysconfig
import tomllib
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

HERE = pathlib.Path(__file__).resolve().parent
CHECKOUT = HERE.parent
PROGRAMS = ["farmctl", "farm-coordinator", "farm-worker"]
MESSAGES = ["model", "fits", "dictionaries"]


class Version(MetadataHookInterface):
    """Sets the version to that of the programs."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        with open(CHECKOUT / "Cargo.toml", "rb") as file:
            metadata["version"] = tomllib.load(file)["workspace"]["package"]["version"]


class Wheel(BuildHookInterface):
    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        programs = built_programs()
        generate(HERE / "src" / "resin_farm" / "_wire")
        build_data["shared_scripts"] = {str(program): program.name for program in programs}
        build_data["artifacts"] = ["src/resin_farm/_wire/**"]
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform_tag(programs)}"


def built_programs() -> list[pathlib.Path]:
    named = os.environ.get("FARM_PROGRAMS")
    if named is None:
        if shutil.which("cargo") is None:
            raise SystemExit(
                "cargo is needed, which is part of Rust; or FARM_PROGRAMS names the folder of the programs"
            )
        packages = [option for program in ["farmctl", *PROGRAMS[1:]] for option in ("--package", program)]
        command = ["cargo", "build", "--release", "--locked", *packages]
        subprocess.run(command, cwd=CHECKOUT, check=True)
    target = os.environ.get("CARGO_TARGET_DIR", CHECKOUT / "target")
    folder = pathlib.Path(named) if named else pathlib.Path(target) / "release"
    programs = [folder.resolve() / program for program in PROGRAMS]
    missing = [str(program) for program in programs if not program.is_file()]
    if missing:
        raise SystemExit(f"FARM_PROGRAMS: there is no {', '.join(missing)}")
    return programs


def generate(folder: pathlib.Path) -> None:
    """Writes the modules of the messages, which lie in this package and not next to it."""
    from grpc_tools import protoc

    folder.mkdir(exist_ok=True)
    (folder / "__init__.py").write_text('"""Generated from the .proto files."""\n', encoding="utf-8")
    include = f"-I{CHECKOUT / 'proto' / 'proto'}"
    files = [f"farm/v1/{name}.proto" for name in MESSAGES]
    if protoc.main(["protoc", include, f"--python_out={folder}", f"--pyi_out={folder}", *files]) != 0:
        raise SystemExit("protoc failed")
    made = folder / "farm" / "v1"
    for file in made.iterdir():
        text = file.read_text(encoding="utf-8").replace("from farm.v1 import", "from resin_farm._wire import")
        (folder / file.name).write_text(text, encoding="utf-8")
        file.unlink()
    made.rmdir()
    made.parent.rmdir()
    (folder / "set_up.py").write_text(set_up(), encoding="utf-8")


def set_up() -> str:
    """A module with the options of the set-up, from the table of the programs. A quantity whose default is reported as
    assumed has a label there."""
    table = (CHECKOUT / "optics" / "model" / "src" / "quantities.rs").read_text(encoding="utf-8")
    groups = re.findall(r"^ {12}(both|options) \{$(.*?)^ {12}\}$", table, re.MULTILINE | re.DOTALL)
    row = re.compile(r'(\w+) \{\s+[^"{}]+"(\w*)",\s+"([^"]+)"\s+\}')
    rows = [found for _, group in groups for found in row.findall(group)]
    fields = "".join(f'    {name}: float\n    """{text}."""\n' for name, _, text in rows)
    labelled = tuple(name for name, label, _ in rows if label)
    return f"import typing\n\n\nclass SetUp(typing.TypedDict, total=False):\n{fields}\n\nLABELLED = {labelled}\n"


def platform_tag(programs: list[pathlib.Path]) -> str:
    if platform.system() != "Linux":
        return re.sub("[-.]", "_", sysconfig.get_platform())
    major, minor = max(newest_glibc(program) for program in programs)
    return f"manylinux_{major}_{minor}_{platform.machine()}"


def newest_glibc(program: pathlib.Path) -> tuple[int, int]:
    from elftools.elf.elffile import ELFFile

    with open(program, "rb") as file:
        needs = ELFFile(file).get_section_by_name(".gnu.version_r")
        names = [version.name for _, versions in needs.iter_versions() for version in versions]
    found = [re.fullmatch(r"GLIBC_(\d+)\.(\d+)(\.\d+)?", name) for name in names]
    return max((int(match[1]), int(match[2])) for match in found if match)
