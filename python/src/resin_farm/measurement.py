"""Measured edge profiles."""

from __future__ import annotations

import csv
import os
import pathlib
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from resin_farm import _display, _optional, _plots, _programs
from resin_farm._wire import model_pb2
from resin_farm.errors import FarmError, InvalidArgument, NotInstalled
from resin_farm.medium import Array

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

# The optional fields of the message.
_SET_UP = tuple(f.name for f in model_pb2.MeasuredProfile.DESCRIPTOR.fields if f.has_presence)
_NEEDED = ("material", "channel", "thickness_mm", "x_mm", "value")


# eq=False: the equality of arrays has no single truth value.
@dataclass(frozen=True, eq=False)
class MeasuredProfile:
    """The brightness across the edge of one slab in one channel."""

    channel: str
    """The channel's name."""
    thickness_mm: float
    """The slab's thickness, in mm."""
    x_mm: Array
    """Pixel centres at a constant pitch, rising from the dark side to the light side; 0 at the edge."""
    values: Array
    """Linear radiance factors."""
    std_errors: Array | None = None
    """Standard errors of the values; None if they are unknown."""
    set_up: Mapping[str, float] = field(default_factory=dict)
    """Parameters of this profile, named as the optional columns of a measurement file. Missing ones are taken from the
    options of a fit."""

    def __init__(
        self,
        channel: str,
        thickness_mm: float,
        x_mm: ArrayLike,
        values: ArrayLike,
        std_errors: ArrayLike | None = None,
        **set_up: float,
    ) -> None:
        """Takes lists or arrays, of which it keeps copies.

        Args:
            channel: the channel's name.
            thickness_mm: the slab's thickness, in mm.
            x_mm: pixel centres in mm, at a constant pitch.
            values: linear radiance factors, one for each pixel.
            std_errors: their standard errors.
            set_up: parameters of this profile, such as `origin_mm=0.1`.

        Raises:
            InvalidArgument: if the arrays have different lengths.
            TypeError: if there is no such parameter.
        """
        if unknown := set(set_up) - set(_SET_UP):
            raise TypeError(f"{', '.join(sorted(unknown))}: the parameters of a profile are {', '.join(_SET_UP)}")
        # A frozen dataclass with its own constructor, so that lists are accepted as well.
        for name, value in (
            ("channel", channel),
            ("thickness_mm", float(thickness_mm)),
            ("x_mm", _own(x_mm)),
            ("values", _own(values)),
            ("std_errors", None if std_errors is None else _own(std_errors)),
            ("set_up", dict(set_up)),
        ):
            object.__setattr__(self, name, value)
        for name, numbers in (("values", self.values), ("std_errors", self.std_errors)):
            if numbers is not None and numbers.shape != (self.x_mm.size,):
                raise InvalidArgument(
                    f"{name}: one for each of the {self.x_mm.size} pixels is needed, not {numbers.shape}"
                )

    def __repr__(self) -> str:
        span = f"{self.x_mm.size} pixels"
        if self.x_mm.size:
            span += f" from {self.x_mm[0]:.3g} to {self.x_mm[-1]:.3g} mm"
            span += f", values {self.values.min():.3g}…{self.values.max():.3g}"
        set_up = "".join(f", {name}={value:g}" for name, value in self.set_up.items())
        errors = "" if self.std_errors is None else ", std_errors"
        return _display.short(self, f"{self.channel}, {self.thickness_mm:g} mm: {span}{errors}{set_up}")

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
    """The material's name."""
    profiles: tuple[MeasuredProfile, ...]
    """One for each slab and channel."""
    _checked: bool = field(init=False, repr=False)

    def __init__(self, material: str, profiles: Iterable[MeasuredProfile]) -> None:
        """Takes the profiles as they are; `fit` and `measure` check them.

        Args:
            material: the material's name.
            profiles: its profiles, of all slabs and channels.
        """
        object.__setattr__(self, "material", material)
        object.__setattr__(self, "profiles", tuple(profiles))
        object.__setattr__(self, "_checked", False)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in the order of the profiles."""
        return tuple(dict.fromkeys(profile.channel for profile in self.profiles))

    @property
    def thicknesses_mm(self) -> tuple[float, ...]:
        """Thicknesses of the slabs, rising, in mm."""
        return tuple(sorted({profile.thickness_mm for profile in self.profiles}))

    @classmethod
    def from_pandas(cls, frame: pandas.DataFrame | Any) -> list[Measurement]:
        """The materials of a frame, which is checked as a file is.

        Args:
            frame: of pandas, or a table with the Arrow stream that polars, pyarrow and others offer, with the columns
                of a measurement file: material, channel, thickness_mm, x_mm, value and optionally std_error and the
                set-up of each profile.

        Raises:
            InvalidArgument: if columns are missing, or values are such that no medium can show them.
            ImportError: if pandas or pyarrow is not installed for a table of another library.
        """
        if not hasattr(frame, "to_csv"):
            _optional.require("data", "pandas", "pyarrow")
            import pyarrow

            frame = pyarrow.table(frame).to_pandas()
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder, "frame.csv")
            # In quotes a name may begin with #, which begins a comment otherwise.
            frame.to_csv(file, index=False, encoding="utf-8", quoting=csv.QUOTE_NONNUMERIC)
            return _read(str(file), "the frame")

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each pixel, with the columns of a measurement file.

        Raises:
            ImportError: if pandas is not installed.
        """
        _optional.require("data", "pandas")
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
        slabs = _display.axis(self.thicknesses_mm)
        return _display.short(self, f"{self.material}: {_display.names(self.channels)}; slabs of {slabs} mm")

    def _repr_html_(self) -> str:
        rows = [
            [p.channel, f"{p.thickness_mm:g}", str(p.values.size), f"{p.x_mm[0]:g}…{p.x_mm[-1]:g}"]
            for p in self.profiles
        ]
        return _display.html_table(("channel", "thickness / mm", "pixels", "x / mm"), rows, self.material)

    def plot(self) -> Figure:
        """All profiles, one panel for each thickness.

        Raises:
            ImportError: if matplotlib is not installed.
        """
        lines = [_plots.Line(p.thickness_mm, p.channel, p.x_mm, p.values, p.channel) for p in self.profiles]
        return _plots.slabs(self.material, lines)

    def _wire(self) -> model_pb2.Measurement:
        return model_pb2.Measurement(material=self.material, profiles=[p._wire() for p in self.profiles])


def _own(numbers: ArrayLike) -> Array:
    """A read-only copy, so that a checked profile cannot change."""
    copy = np.array(numbers, dtype=float)
    copy.setflags(write=False)
    return copy


class MeasurementWarning(UserWarning):
    """An assumption that was made when a measurement was read, or a likely error in it."""


def read_measurements(path: str | os.PathLike[str]) -> list[Measurement]:
    """The materials of a measurement file, as farmctl reads it: CSV, also with decimal commas, other separators, units
    and names of columns. Assumptions and likely errors cause a `MeasurementWarning`.

    Args:
        path: the file.

    Raises:
        InvalidArgument: with line and column, if it cannot be read, or contains values that no medium can show.
    """
    return _read(os.fspath(path), None)


def checked(materials: Iterable[Measurement]) -> list[Measurement]:
    """Applies the checks of measurement files to measurements in memory, once each."""
    found = list(materials)
    unchecked = [material for material in found if not material._checked]
    if unchecked:
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder, "measurement.csv")
            write(unchecked, file)
            _read(str(file), "the measurement")
        for material in unchecked:
            object.__setattr__(material, "_checked", True)
    return found


def write(materials: Sequence[Measurement], file: pathlib.Path) -> None:
    """Writes a measurement file."""
    has_errors = any(profile.std_errors is not None for material in materials for profile in material.profiles)
    columns = [*_NEEDED, *(["std_error"] if has_errors else []), *_SET_UP]
    with open(file, "w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, columns, extrasaction="ignore", quoting=csv.QUOTE_NONNUMERIC)
        writer.writeheader()
        writer.writerows(row for material in materials for row in _rows(material))


def _rows(material: Measurement) -> Iterator[dict[str, Any]]:
    for profile in material.profiles:
        common = {"material": material.material, "channel": profile.channel, "thickness_mm": profile.thickness_mm}
        common |= profile.set_up
        errors = [None] * profile.values.size if profile.std_errors is None else profile.std_errors.tolist()
        for x, value, error in zip(profile.x_mm.tolist(), profile.values.tolist(), errors, strict=True):
            yield common | {"x_mm": x, "value": value, "std_error": error}


def _read(path: str, name: str | None) -> list[Measurement]:
    """Reads a file through farmctl; messages refer to it by `name`."""
    try:
        found = _programs.farmctl(["check", path])
    except NotInstalled:
        raise
    except FarmError as error:
        message = error.message.replace(f"measurement {path}", name) if name else error.message
        raise InvalidArgument(message) from None
    warn(f"{name or path}: {note['text']} ({note['code']})" for note in found["notes"])
    return [_material(material) for material in found["materials"]]


def warn(texts: Iterable[str]) -> None:
    """Warns at the line that used this package."""
    for text in texts:
        warnings.warn(text, MeasurementWarning, stacklevel=_outside())


def _outside() -> int:
    """The number of frames from the calling function up to the line that used this package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(os.path.dirname(__file__)):
        level, frame = level + 1, frame.f_back
    return level


def _material(found: Mapping[str, Any]) -> Measurement:
    def profile(one: Mapping[str, Any]) -> MeasuredProfile:
        set_up = {name: one[name] for name in _SET_UP if one[name] is not None}
        return MeasuredProfile(
            one["channel"], one["thickness_mm"], one["x_mm"], one["values"], one["std_errors"], **set_up
        )

    measurement = Measurement(found["material"], [profile(one) for one in found["profiles"]])
    object.__setattr__(measurement, "_checked", True)
    return measurement
