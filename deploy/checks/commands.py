"""Compares all command lines and variables in the deployment's files with the programs.

usage: commands.py FILE...   units, compose.yaml, rendered Kubernetes objects, Containerfile, README.md
"""

import json
import re
import shlex
import sys
from pathlib import Path

import programs
import yaml

CODE = re.compile(r"^```(sh|console)\b[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)


def of_unit(text):
    for line in text.replace("\\\n", " ").splitlines():
        key, _, value = line.partition("=")
        if key.startswith("Exec"):
            words = shlex.split(value)
            yield [Path(words[0]).name, *words[1:]], []
        elif key == "Environment":
            yield None, [word.partition("=")[0] for word in shlex.split(value)]


def of_compose(document):
    for service in document["services"].values():
        yield service["command"], list(service.get("environment", {}))
        yield service["healthcheck"]["test"][1:], []


def of_object(document):
    template = document.get("spec", {}).get("template", {}).get("spec", {})
    for container in template.get("containers", []) + template.get("initContainers", []):
        variables = [variable["name"] for variable in container.get("env", [])]
        yield container["command"] + container.get("args", []), variables
        for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
            command = container.get(probe, {}).get("exec", {}).get("command")
            if command:
                yield command, []


def of_containerfile(text):
    for command in re.findall(r"CMD (\[.*\])", text):
        yield json.loads(command), []
    for line in re.findall(r"^ENV (.*)", text, re.MULTILINE):
        yield None, [word.partition("=")[0] for word in shlex.split(line)]


def of_document(text):
    """Commands of the programs in shell examples, also behind sudo, docker and kubectl."""
    for language, block in CODE.findall(text):
        lines = block.replace("\\\n", " ").splitlines()
        if language == "console":
            lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        for line in lines:
            words = shlex.split(line, comments=True)
            for part in split(words, ("&&", "||", "|", ";", "&")):
                assigned = [word.partition("=")[0] for word in part if re.match(r"^FARM_(?!IMAGE|PUBLISH|CPUS)\w+=", word)]
                yield program_of(part), assigned


def split(words, separators):
    part = []
    for word in words:
        if word in separators:
            yield part
            part = []
        else:
            part.append(word)
    yield part


def program_of(words):
    while words and (words[0] in ("sudo", "export") or "=" in words[0]):
        words = words[1:]
    if words[:1] == ["kubectl"]:
        words = words[words.index("--") + 1 :] if "--" in words else []
    elif words[:1] == ["docker"]:
        first = (i for i, word in enumerate(words) if word in programs.PROGRAMS)
        words = words[next(first, len(words)) :]
    words = [word for word in words if not word.startswith((">", "2>"))]
    return words if words and words[0] in programs.PROGRAMS else None


def of_file(path):
    text = path.read_text()
    if path.suffix == ".service":
        yield from of_unit(text)
    elif path.suffix == ".md":
        yield from of_document(text)
    elif path.name == "Containerfile":
        yield from of_containerfile(text)
    else:
        for document in yaml.safe_load_all(text):
            yield from of_compose(document) if "services" in document else of_object(document)


def main():
    count, wrong = 0, []
    for path in map(Path, sys.argv[1:]):
        before = count
        for command, variables in of_file(path):
            if command and command[0] in programs.PROGRAMS:
                count += 1
                wrong += [f"{path}: {problem}" for problem in programs.problems(command)]
            known = programs.variables(command[0]) if command and path.suffix != ".md" else programs.all_variables()
            # A container's variables may be meant for its health check, which is farmctl.
            known = known | programs.variables("farmctl")
            unknown = {name for name in variables if name.startswith("FARM_")} - known
            wrong += [f"{path}: no program reads {name}" for name in sorted(unknown)]
        if count == before:
            wrong.append(f"{path}: no command of the farm in it")
    print("\n".join(wrong) or f"  {count} command lines agree with the programs")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
