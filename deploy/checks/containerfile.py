"""Checks rules of the Containerfile that a linter does not have.

usage: containerfile.py CONTAINERFILE CHECKOUT
"""

import re
import sys
import tomllib
from pathlib import Path


def instructions(text):
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        name, _, rest = line.strip().partition(" ")
        if name:
            yield name.upper(), rest.strip()


def last(found, name):
    return next((rest for key, rest in reversed(found) if key == name), None)


def problems(containerfile, checkout):
    found = list(instructions(containerfile.read_text()))
    final = found[max(i for i, (name, _) in enumerate(found) if name == "FROM") :]
    if not re.fullmatch(r"[1-9]\d*:[1-9]\d*", last(final, "USER") or ""):
        yield "USER must be two numbers, so that Kubernetes sees that it is not root"
    for name, wanted in (("HEALTHCHECK", ""), ("STOPSIGNAL", "SIGTERM"), ("VOLUME", "/data"), ("CMD", "[")):
        if not (last(final, name) or "").startswith(wanted) or last(final, name) is None:
            yield f"{name} {wanted} is missing in the final stage"
    if last(final, "ENTRYPOINT") is not None:
        yield "ENTRYPOINT must not be set: the command chooses the program"
    yield from base_problems(found)
    yield from context_problems(containerfile, found, checkout)


def base_problems(found):
    defaults = dict(rest.partition("=")[::2] for name, rest in found if name == "ARG" and "=" in rest)
    for image in (rest.split()[0] for name, rest in found if name == "FROM"):
        image = re.sub(r"\$\{(\w+)\}", lambda match: defaults.get(match[1], ""), image)
        tag = image.rpartition("/")[2].partition(":")[2]
        if tag in ("", "latest"):
            yield f"FROM {image}: a tag other than latest is needed"


def context_problems(containerfile, found, checkout):
    """Checks that copied files exist, and that the ignore file lets every crate of the workspace through."""
    ignore = containerfile.with_name(containerfile.name + ".dockerignore").read_text().splitlines()
    let_in = {line[1:] for line in ignore if line.startswith("!")}
    if "*" not in ignore:
        yield "the ignore file must begin with *: only what is named goes in"
    for name in sorted(let_in):
        if not (checkout / name).exists():
            yield f"the ignore file admits {name}, which does not exist"
    workspace = tomllib.loads((checkout / "Cargo.toml").read_text())["workspace"]
    for name in ["Cargo.toml", "Cargo.lock", *workspace["members"]]:
        # A folder includes its content.
        if name.partition("/")[0] not in let_in:
            yield f"the ignore file does not admit {name}, without which nothing is built"
    for words in (rest.split() for name, rest in found if name == "COPY"):
        if not any(word.startswith("--from=") for word in words):
            sources = [word for word in words if not word.startswith("--")][:-1]
            yield from (f"COPY {source}: does not exist" for source in sources if not (checkout / source).exists())


def main():
    containerfile, checkout = map(Path, sys.argv[1:])
    wrong = list(problems(containerfile, checkout))
    print("\n".join(wrong) or "  the Containerfile is as it should be")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
