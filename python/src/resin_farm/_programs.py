"""Runs the farm's programs, which are part of the wheel."""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from typing import Any

from resin_farm.errors import FarmError, InvalidArgument


def program(name: str) -> str:
    """The path of a program: in the folder that FARM_PROGRAMS names, next to this Python, or on the path."""
    named = os.environ.get("FARM_PROGRAMS")
    folders = [named] if named else [sysconfig.get_path("scripts"), str(pathlib.Path(sys.executable).parent), None]
    for folder in folders:
        if found := shutil.which(name, path=folder):
            return found
    raise FarmError(f"{name} is not there: looked in {named or 'the scripts of this Python and on the path'}")


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
