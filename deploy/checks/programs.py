"""Reads the options of the farm's programs from their --help, and checks command lines with them."""

import functools
import os
import re
import subprocess

PROGRAMS = ("farm-coordinator", "farm-worker", "farmctl")
# Read by the logging library, and in no --help.
FURTHER_VARIABLES = {"FARM_LOG"}
# Values are not checked, since documents contain placeholders: GRID.toml, $HOME, 8.
OPTION = re.compile(r"^\s+(?:-(?P<short>\w), )?--(?P<long>[a-z][a-z-]*)(?:[ =]<(?P<value>[^>]+)>)?", re.MULTILINE)


@functools.cache
def help_text(*command):
    path = os.path.join(os.environ["BIN"], command[0])
    # farmctl has a short help, too.
    option = "--help-all" if command[0] == "farmctl" else "--help"
    done = subprocess.run([path, *command[1:], option], capture_output=True, text=True, timeout=30, check=False)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)} --help: exit code {done.returncode}: {done.stderr.strip()}")
    return done.stdout


@functools.cache
def options(*command):
    """Every spelling of every option, and whether it takes a value."""
    found = {"--help": False, "-h": False}
    for match in OPTION.finditer(help_text(*command)):
        takes = match["value"] is not None
        found["--" + match["long"]] = takes
        if match["short"]:
            found["-" + match["short"]] = takes
    return found


@functools.cache
def verbs(*command):
    section = re.search(r"^Commands:\n((?:  .*\n)+)", help_text(*command), re.MULTILINE)
    return set(re.findall(r"^  ([a-z][a-z-]*)", section[1], re.MULTILINE)) if section else set()


def variables(program):
    """Environment variables that set options of the program."""
    return set(re.findall(r"\[env: (\w+)=", help_text(program))) | FURTHER_VARIABLES


def all_variables():
    return set().union(*(variables(program) for program in PROGRAMS))


def problems(argv):
    """Yields the errors of a command line."""
    command, rest = [argv[0]], list(argv[1:])
    while rest:
        word = rest.pop(0)
        if not word.startswith("-") or word == "-":
            if verbs(*command):
                if word not in verbs(*command):
                    yield f"{' '.join(command)} has no verb {word}"
                    return
                command.append(word)
            continue
        name, _, value = word.partition("=")
        known = options(*command)
        if name not in known:
            yield f"{' '.join(command)} has no option {name}"
        elif known[name] and not value:
            if not rest or rest[0].startswith("--"):
                yield f"{' '.join(command)} {name} needs a value"
            else:
                rest.pop(0)
        elif value and not known[name]:
            yield f"{' '.join(command)} {name} takes no value"
