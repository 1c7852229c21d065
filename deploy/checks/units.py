"""Checks rules of the systemd units that systemd-analyze does not have.

usage: units.py UNIT...
"""

import shlex
import sys
from pathlib import Path

from durations import enough_to_stop, seconds


def settings(text):
    """All values of each key."""
    found = {}
    for line in text.splitlines():
        key, separator, value = line.partition("=")
        if separator and not key.startswith(("#", ";")):
            found.setdefault(key.strip(), []).append(value.strip())
    return found


def problems(name, unit):
    command = shlex.split(unit["ExecStart"][0])
    variables = dict(value.partition("=")[::2] for value in unit["Environment"])
    stop_s = seconds(unit["TimeoutStopSec"][0])
    yield from enough_to_stop(name, command, stop_s, variables.get("FARM_GRACE"))
    credentials = {value.partition(":")[0] for value in unit["LoadCredential"]}
    for word in command:
        _, found, credential = word.partition("${CREDENTIALS_DIRECTORY}/")
        if found and credential not in credentials:
            yield f"{name}: {word}: LoadCredential= has no {credential}"
    if "${STATE_DIRECTORY}" in command and "StateDirectory" not in unit:
        yield f"{name}: ${{STATE_DIRECTORY}} needs StateDirectory="
    if command[0].endswith("farm-worker") and unit.get("RestartPreventExitStatus") != ["4"]:
        yield f"{name}: RestartPreventExitStatus= must be 4, or a refused worker comes back for ever"
    if not all(value.startswith("-") for value in unit["EnvironmentFile"]):
        yield f"{name}: EnvironmentFile= must begin with -, since the file need not exist"


def main():
    wrong = []
    for path in map(Path, sys.argv[1:]):
        wrong += problems(path.name, settings(path.read_text()))
    print("\n".join(wrong) or "  units name what they have, and give everybody time to stop")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
