"""Profiles that were made from photographs, with their session and report."""

from __future__ import annotations

import html
import json
import pathlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from resin_farm import _display
from resin_farm.measurement import Measurement, read_measurements


@dataclass(frozen=True)
class Capture:
    """The results of `Farm.capture`, in a folder."""

    folder: pathlib.Path
    """The folder that `capture` wrote."""
    session: dict[str, Any] = field(repr=False)
    """Set-up, board, camera, noise and errors by source (session.json)."""

    @classmethod
    def read(cls, folder: pathlib.Path) -> Capture:
        """The results of an earlier `capture`.

        Args:
            folder: the folder that it wrote.

        Raises:
            OSError: if there is no `session.json` in it.
        """
        return cls(folder, json.loads((folder / "session.json").read_text(encoding="utf-8")))

    @cached_property
    def measurements(self) -> list[Measurement]:
        """The profiles of all materials."""
        return read_measurements(self.folder / "measurements.csv")

    @property
    def report(self) -> pathlib.Path:
        """A page with every photograph, profile and error."""
        return self.folder / "report.html"

    def __repr__(self) -> str:
        return _display.short(self, f"{self.folder}: {_display.names([m.material for m in self.measurements])}")

    def _repr_html_(self) -> str:
        materials = "".join(m._repr_html_() for m in self.measurements)
        return f'{materials}<p><a href="{html.escape(str(self.report))}">report</a></p>'
