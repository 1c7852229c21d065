"""Imports packages that only some methods need."""

from __future__ import annotations

import importlib


def require(extra: str, *packages: str) -> None:
    """Imports packages of an optional group of dependencies.

    Raises:
        ImportError: if one is not installed, with the command that installs it.
    """
    for package in packages:
        try:
            importlib.import_module(package)
        except ImportError as error:
            raise ImportError(f"this needs {package}: pip install 'resin-farm[{extra}]' ({error})") from error
