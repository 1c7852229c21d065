"""Compares the system calls that a program made with those that its unit allows.

usage: syscalls.py UNIT STRACE_SUMMARY
"""

import re
import subprocess
import sys
from pathlib import Path

from units import settings


def groups():
    """Every group of systemd, with its members."""
    done = subprocess.run(["systemd-analyze", "syscall-filter", "--no-pager"], capture_output=True, text=True, check=True)
    found, current = {}, None
    for line in done.stdout.splitlines():
        word = line.strip()
        if line.startswith("@"):
            current = found.setdefault(word, set())
        elif current is not None and line.startswith(" ") and word and not word.startswith("#"):
            current.add(word)
    return found


def members(name, known):
    if not name.startswith("@"):
        return {name}
    return set().union(*(members(inner, known) for inner in known[name]))


def allowed(unit):
    known = groups()
    calls = members("@default", known)
    for value in unit["SystemCallFilter"]:
        named = set().union(*(members(name, known) for name in value.lstrip("~").split()))
        calls = calls - named if value.startswith("~") else calls | named
    return calls


def made(summary):
    """The last column of the table, without its head and its total."""
    rows = re.findall(r"^ *\d+\.\d+ .* (\w+)$", summary, re.MULTILINE)
    return set(rows) - {"total"}


def main():
    unit, summary = map(Path, sys.argv[1:])
    calls = made(summary.read_text())
    if not calls:
        sys.exit(f"{summary}: no system calls in it")
    forbidden = calls - allowed(settings(unit.read_text()))
    if forbidden:
        sys.exit(f"{unit.name}: SystemCallFilter= forbids {', '.join(sorted(forbidden))}, which the program makes")
    print(f"  {unit.name}: allows all {len(calls)} system calls that a small grid takes")


if __name__ == "__main__":
    main()
