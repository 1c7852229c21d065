"""Compares command lines in the files for PBS, HTCondor and Nomad with the programs; checks the syntax of the files.

usage: schedulers.py FILE...
"""

import re
import shlex
import sys
from pathlib import Path

import hcl2
import programs


def of_pbs(path, text):
    line = next(line for line in text.replace("\\\n", " ").splitlines() if line.startswith("exec "))
    yield ["farm-worker", *shlex.split(line)[2:]]


def of_htcondor(path, text):
    settings = {}
    for line in text.splitlines():
        if line.startswith(("#", "queue")) or not line.strip():
            continue
        name, equals, value = line.partition("=")
        if not equals or not re.fullmatch(r"\w+", name.strip()):
            raise SystemExit(f"{path}: {line!r} is no setting")
        settings[name.strip()] = value.strip()
    missing = {"executable", "arguments", "request_cpus", "request_memory", "kill_sig"} - set(settings)
    if missing or not re.search(r"^queue\b", text, re.MULTILINE):
        raise SystemExit(f"{path}: {', '.join(sorted(missing)) or 'queue'} is missing")
    yield [settings["executable"], *shlex.split(settings["arguments"])]


def of_nomad(path, text):
    found = hcl2.loads(text)

    def within(node, key):
        if isinstance(node, dict):
            for name, value in node.items():
                if name.strip('"') == key:
                    yield value
                yield from within(value, key)
        elif isinstance(node, list):
            for value in node:
                yield from within(value, key)

    arguments = next(within(found, "args"))
    yield ["farm-worker", *(argument.strip('"') for argument in arguments)]


def main():
    kinds = {".pbs": of_pbs, ".sub": of_htcondor, ".hcl": of_nomad}
    count = 0
    for path in map(Path, sys.argv[1:]):
        for command in kinds[path.suffix](path, path.read_text()):
            count += 1
            if wrong := list(programs.problems(command)):
                raise SystemExit(f"{path}: {'; '.join(wrong)}")
    print(f"{count} command lines agree with the programs")


if __name__ == "__main__":
    main()
