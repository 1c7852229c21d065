"""Runs the farm's programs, which are part of the wheel."""

from __future__ import annotations

import importlib.metadata
import json
import os
import pathlib
import shutil
import subprocess
from collections.abc import Sequence
from typing import Any

from resin_farm.errors import FarmError, InvalidArgument, NotInstalled


def program(name: str) -> str:
    """The path of a program: in the folder that FARM_PROGRAMS names, where the wheel was installed, or on the path.

    Raises:
        NotInstalled: if it is in none of them.
    """
    named = os.environ.get("FARM_PROGRAMS")
    if not named and (recorded := _recorded(name)):
        return recorded
    if found := shutil.which(name, path=named or None):
        return found
    raise NotInstalled(f"{name} is not there: looked in {named or 'the files of the wheel and on the path'}")


def _recorded(name: str) -> str | None:
    """The path of a program by the wheel's own record of its files, which holds for each kind of installation."""
    try:
        files = importlib.metadata.files("resin-farm")
    except importlib.metadata.PackageNotFoundError:
        return None
    places = (pathlib.Path(str(file.locate())).resolve() for file in files or [] if file.name == name)
    return next((str(place) for place in places if os.access(place, os.X_OK)), None)


def farmctl(arguments: Sequence[str], *, timeout: float | None = None) -> dict[str, Any]:
    """Runs farmctl and returns the data of its answer.

    Raises:
        InvalidArgument: if a value is out of its range.
        FarmError: with the message of farmctl, if it fails otherwise.
    """
    command = [program("farmctl"), "--json", "--quiet", *arguments]
    # Only the arguments select the farm.
    inherited = {
        name: value for name, value in os.environ.items() if name not in ("FARM_SERVER", "FARM_ACCESS", "FARM_DATA")
    }
    ran = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        timeout=timeout,
        check=False,
        env=inherited,
    )
    if ran.returncode == 0 and not ran.stdout:
        return {}
    try:
        answer = json.loads(ran.stdout)
    except ValueError:
        raise FarmError(ran.stderr.strip() or f"{' '.join(command)} ended with code {ran.returncode}") from None
    if answer["kind"] == "error":
        error = answer["data"]
        if "field" in error:
            raise InvalidArgument(error["message"], {error["field"]: error["allowed"]})
        raise FarmError(error["message"])
    data: dict[str, Any] = answer["data"]
    return data
