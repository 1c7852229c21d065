"""Measured edge profiles."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resin_farm import _display
from resin_farm._wire import model_pb2
from resin_farm.errors import InvalidArgument

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_SET_UP = ("thickness_std_error_mm", "origin_mm", "origin_std_error_mm", "blur_mm", "blur_std_error_mm")
_NEEDED = ("material", "channel", "thickness_mm", "x_mm", "value")


# Arrays have no truth value of their equality.
@dataclass(frozen=True, eq=False)
class MeasuredProfile:
    """The brightness across the edge of one slab in one channel."""

    channel: str
    thickness_mm: float
    x_mm: Array
    """Pixel centres at a constant pitch, rising from the dark side to the light side; 0 at the edge."""
    values: Array
    """Linear radiance factors."""
    std_errors: Array | None = None
    set_up: Mapping[str, float] = field(default_factory=dict)
    """What is known of this profile: `thickness_std_error_mm`, `origin_mm`, `origin_std_error_mm`, `blur_mm`,
    `blur_std_error_mm`. What is missing is taken from the options of a fit."""

    def __init__(
        self,
        channel: str,
        thickness_mm: float,
        x_mm: ArrayLike,
        values: ArrayLike,
        std_errors: ArrayLike | None = None,
        **set_up: float,
    ) -> None:
        if unknown := set(set_up) - set(_SET_UP):
            raise TypeError(f"{', '.join(sorted(unknown))}: what is known of a profile is {', '.join(_SET_UP)}")
        # A frozen dataclass with its own constructor, so that lists are taken as well.
        for name, value in (
            ("channel", channel),
            ("thickness_mm", float(thickness_mm)),
            ("x_mm", np.asarray(x_mm, dtype=float)),
            ("values", np.asarray(values, dtype=float)),
            ("std_errors", None if std_errors is None else np.asarray(std_errors, dtype=float)),
            ("set_up", dict(set_up)),
        ):
            object.__setattr__(self, name, value)

    def _wire(self) -> model_pb2.MeasuredProfile:
        return model_pb2.MeasuredProfile(
            channel=self.channel,
            thickness_mm=self.thickness_mm,
            x_mm=self.x_mm,
            values=self.values,
            std_errors=[] if self.std_errors is None else self.std_errors,
            **self.set_up,
        )


@dataclass(frozen=True, eq=False)
class Measurement:
    """All profiles of a material."""

    material: str
    profiles: tuple[MeasuredProfile, ...]

    def __init__(self, material: str, profiles: Iterable[MeasuredProfile]) -> None:
        object.__setattr__(self, "material", material)
        object.__setattr__(self, "profiles", tuple(profiles))

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(profile.channel for profile in self.profiles))

    @property
    def thicknesses_mm(self) -> tuple[float, ...]:
        return tuple(sorted({profile.thickness_mm for profile in self.profiles}))

    @classmethod
    def from_pandas(cls, frame: pandas.DataFrame) -> list[Measurement]:
        """The materials of a frame with the columns of a measurement file: material, channel, thickness_mm, x_mm, value
        and, as far as they are known, std_error and what is known of the set-up."""
        return _materials(frame.to_dict(orient="records"), "the frame", list(frame.columns))

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each pixel, as in a measurement file."""
        import pandas

        frames = []
        for profile in self.profiles:
            columns: dict[str, Any] = {
                "material": self.material,
                "channel": profile.channel,
                "thickness_mm": profile.thickness_mm,
                "x_mm": profile.x_mm,
                "value": profile.values,
            }
            if profile.std_errors is not None:
                columns["std_error"] = profile.std_errors
            frames.append(pandas.DataFrame(columns | dict(profile.set_up)))
        return pandas.concat(frames, ignore_index=True)

    def __repr__(self) -> str:
        slabs = ", ".join(f"{t:g}" for t in self.thicknesses_mm)
        return f"Measurement({self.material!r}: {'/'.join(self.channels)}, slabs of {slabs} mm)"

    def _repr_html_(self) -> str:
        rows = [
            [p.channel, f"{p.thickness_mm:g}", str(p.values.size), f"{p.x_mm[0]:g}…{p.x_mm[-1]:g}"] for p in self.profiles
        ]
        return _display.html_table(("channel", "thickness / mm", "pixels", "x / mm"), rows, self.material)

    def plot(self) -> Figure:
        """All profiles, one panel for each thickness."""
        from resin_farm import _plots

        return _plots.measurement(self)

    def _wire(self) -> model_pb2.Measurement:
        return model_pb2.Measurement(material=self.material, profiles=[p._wire() for p in self.profiles])


def read_measurements(path: str | os.PathLike[str]) -> list[Measurement]:
    """The materials of a measurement file: CSV with the columns material, channel, thickness_mm, x_mm, value and, as far as
    they are known, std_error and what is known of the set-up. Lines that begin with # are comments.

    This reads the strict form alone. `farmctl` also reads decimal commas, other units and names of columns.

    Raises:
        InvalidArgument: if a column is missing or something is no number.
        OSError: if the file cannot be read.
    """
    with open(path, encoding="utf-8", newline="") as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#") and line.strip())
        return _materials(list(rows), os.fspath(path), list(rows.fieldnames or []))


def _materials(rows: Iterable[Mapping[Any, Any]], where: str, columns: list[str]) -> list[Measurement]:
    missing = [name for name in _NEEDED if name not in columns]
    unknown = [name for name in columns if name not in (*_NEEDED, "std_error", *_SET_UP)]
    if missing or unknown:
        wrong = f"there is no {', '.join(missing)}" if missing else f"{', '.join(map(str, unknown))} is unknown"
        allowed = f"columns are {', '.join(_NEEDED)}, and may be std_error, {', '.join(_SET_UP)}"
        raise InvalidArgument(f"{where}: {wrong}; {allowed}", {"columns": allowed})
    materials: dict[str, dict[tuple[str, float], list[dict[str, float]]]] = {}
    for number, row in enumerate(rows, start=1):
        told = {name: _number(row[name], where, number, name) for name in columns if name not in _NEEDED[:2]}
        profile = materials.setdefault(str(row["material"]), {})
        profile.setdefault((str(row["channel"]), told["thickness_mm"]), []).append(told)
    return [
        Measurement(material, [_profile(channel, t, pixels, where) for (channel, t), pixels in profiles.items()])
        for material, profiles in materials.items()
    ]


def _number(cell: Any, where: str, row: int, column: str) -> float:
    if cell is None or cell == "":
        return float("nan")
    try:
        return float(cell)
    except ValueError:
        message = f"{where}, row {row}: {column} = {cell!r} is no number"
        raise InvalidArgument(message, {column: "a number is needed"}) from None


def _profile(channel: str, thickness_mm: float, pixels: list[dict[str, float]], where: str) -> MeasuredProfile:
    def column(name: str) -> Array:
        return np.array([pixel.get(name, np.nan) for pixel in pixels])

    set_up = {}
    for name in _SET_UP:
        told = column(name)
        if not np.isnan(told).all():
            if not (told == told[0]).all():
                message = f"{where}: {name} differs within {channel} at {thickness_mm:g} mm"
                raise InvalidArgument(message, {name: "the same in all rows of a profile"})
            set_up[name] = float(told[0])
    errors = column("std_error")
    return MeasuredProfile(
        channel, thickness_mm, column("x_mm"), column("value"), None if np.isnan(errors).all() else errors, **set_up
    )
