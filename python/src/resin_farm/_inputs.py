"""Turns the arguments of a farm's methods into measurements, messages and files for farmctl."""

from __future__ import annotations

import os
import pathlib
import re
import tempfile
from typing import TYPE_CHECKING, Any, TypeAlias

from resin_farm import _programs
from resin_farm._wire import model_pb2
from resin_farm.errors import InvalidArgument
from resin_farm.grid import Grid
from resin_farm.measurement import Measurement, checked, read_measurements
from resin_farm.medium import Medium

if TYPE_CHECKING:
    import pandas

Path: TypeAlias = str | os.PathLike[str]
"""The path of a file or folder."""

Materials: TypeAlias = "list[Measurement] | tuple[Measurement, ...] | Measurement | pandas.DataFrame | Path"
"""Measurements, a frame with the columns of a measurement file, or the path of such a file."""


def submitted(grid: Grid, arguments: list[str]) -> dict[str, Any]:
    """Submits a grid by a file, which messages do not name."""
    with tempfile.TemporaryDirectory() as folder:
        # The file's name is the dictionary's.
        file = pathlib.Path(folder, "paper.toml" if grid == Grid() else "grid.toml")
        file.write_text(grid.to_toml(), encoding="utf-8")
        try:
            return _programs.farmctl([*arguments, str(file)])
        except InvalidArgument as error:
            message = re.sub(rf"grid file {re.escape(str(file))}(, line \d+)?", "the grid", error.message)
            raise InvalidArgument(message, error.fields) from None


def folder(given: object) -> pathlib.Path | None:
    if not isinstance(given, str | os.PathLike):
        return None
    path = pathlib.Path(given)
    return path if path.is_dir() else None


def wire_medium(medium: Medium) -> model_pb2.Medium:
    return model_pb2.Medium(sigma_t_per_mm=medium.sigma_t_per_mm, albedo=medium.albedo, g=medium.g)


def one(given: Materials) -> Measurement:
    materials = measurements(given)
    if len(materials) != 1:
        names = ", ".join(m.material for m in materials)
        raise InvalidArgument(f"one material is expected, and these are {names}: measure takes several")
    return materials[0]


def measurements(given: Materials) -> list[Measurement]:
    if isinstance(given, Measurement):
        return checked([given])
    if isinstance(given, str | os.PathLike):
        return read_measurements(given)
    if isinstance(given, list | tuple):
        return checked(given)
    return Measurement.from_pandas(given)
