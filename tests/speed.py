#!/usr/bin/env python3
"""Times the programs of this checkout against those of an earlier release, in turn on the same machine.

    tests/speed.py OLD NEW [--rounds 3] [--only NAME]

OLD and NEW are folders with a release build of farmctl. For each case it prints the least wall time, processor time and
peak memory of both, their ratios, and whether both wrote the same. Needs Python 3.11 and Linux; takes some ten minutes.
"""

import argparse
import hashlib
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field

ROOT = pathlib.Path(__file__).resolve().parent.parent


@dataclass
class Case:
    """A command, what must have run before, and the file that it writes if that is to be compared."""

    name: str
    command: list[str]
    before: list[list[str]] = field(default_factory=list)
    written: str | None = None
    # Whether `before` runs again in each round, in an empty folder.
    fresh: bool = False


PAPER = ["submit", "paper", "-q"]
CAPTURE = ["capture", "examples/session/session.toml", "-o", "session", "-q"]
WHITE = ["examples/white.csv", "--dictionary", "paper", "--json"]
CASES = [
    Case("the paper's dictionary", PAPER, fresh=True),
    Case("a draft of lab", ["submit", "lab", "--quality", "draft", "-q"], fresh=True),
    Case("measure white.csv", ["measure", *WHITE], [PAPER]),
    Case("measure by the paper", ["measure", *WHITE, "--objective", "paper"], [PAPER]),
    Case("fit with curves", ["fit", *WHITE, "--plot", "fit.svg"], [PAPER]),
    Case("capture of a session", [*CAPTURE, "--json"], fresh=True),
    Case("measure of a session, first", ["measure", "session", "-q", "--json"], [CAPTURE], fresh=True),
    Case("measure of a session, again", ["measure", "session", "-q", "--json"], [CAPTURE, ["measure", "session", "-q"]]),
    Case("export as CSV", ["export", "paper", "-o", "paper.csv"], [PAPER], "paper.csv"),
    Case("export for NumPy", ["export", "paper", "--npz", "paper.npz"], [PAPER], "paper.npz"),
]


@dataclass
class Run:
    """Wall time in s, processor time in s, peak memory in MB, and the digest of the output."""

    wall: float
    processor: float
    memory: float
    digest: str


def once(program: pathlib.Path, folder: pathlib.Path, command: list[str], written: str | None) -> Run:
    """Runs a command; an exit code other than 0 ends the comparison."""
    begin = time.monotonic()
    child = subprocess.Popen([program, *command], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, errors = child.stdout.read(), child.stderr.read()
    _, status, usage = os.wait4(child.pid, 0)
    wall = time.monotonic() - begin
    if status != 0:
        sys.exit(f"{program} {' '.join(command)}: {errors.decode()}")
    digest = hashlib.sha256(out)
    if written:
        with open(folder / written, "rb") as file:
            digest = hashlib.file_digest(file, "sha256")
        (folder / written).unlink()
    return Run(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1000, digest.hexdigest())


def prepared(program: pathlib.Path, folder: pathlib.Path, case: Case) -> None:
    """An empty folder with the examples, in which the earlier commands have run."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    shutil.copytree(ROOT / "examples", folder / "examples")
    for command in case.before:
        once(program, folder, command, None)


def compared(case: Case, programs: list[pathlib.Path], rounds: int, place: pathlib.Path) -> list[list[Run]]:
    """The runs of both programs, in turn."""
    folders = [place / name for name in ("old", "new")]
    runs: list[list[Run]] = [[], []]
    for number in range(rounds):
        for program, folder, own in zip(programs, folders, runs, strict=True):
            if case.fresh or number == 0:
                prepared(program, folder, case)
            own.append(once(program, folder, case.command, case.written))
    return runs


def line(case: Case, runs: list[list[Run]]) -> str:
    def cell(of: str, digits: int) -> str:
        old, new = (min(getattr(run, of) for run in own) for own in runs)
        return f"{old:8.{digits}f} {new:8.{digits}f} {old / max(new, 1e-9):6.2f}"

    same = "same" if runs[0][-1].digest == runs[1][-1].digest else "differs"
    return f"{case.name:29}{cell('wall', 2)}   {cell('processor', 2)}   {cell('memory', 0)}   {same}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=pathlib.Path)
    parser.add_argument("new", type=pathlib.Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    args = parser.parse_args()
    programs = [(folder / "farmctl").resolve() for folder in (args.old, args.new)]
    print(f"{'least of ' + str(args.rounds):29}{'wall [s]: old, new, ratio':26}{'processor [s]':27}{'memory [MB]':26} output")
    with tempfile.TemporaryDirectory() as place:
        for case in CASES:
            if args.only in case.name:
                print(line(case, compared(case, programs, args.rounds, pathlib.Path(place))), flush=True)


if __name__ == "__main__":
    main()
