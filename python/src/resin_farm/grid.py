"""Grids of parameters for which dictionaries are computed."""

from __future__ import annotations

import json
import pathlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from resin_farm import _display

Axis: TypeAlias = Sequence[float] | NDArray[np.floating]
"""Numbers along an axis of a grid."""


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A grid: the product of its axes. Fields that are None have the values of the paper's grid.

    Every axis must rise strictly.
    """

    sigma_t_per_mm: Axis | None = None
    """Extinction coefficients, in 1/mm."""
    albedo: Axis | None = None
    """Single-scattering albedos."""
    g: Axis | None = None
    """Anisotropies: mean cosines of the phase function, whose shape is the scene's."""
    thickness_mm: Axis | None = None
    """Thicknesses of the slab, in mm."""
    sample_ior: Axis | None = None
    """Refractive indices of the slab."""
    scene: str | None = None
    """"lab", "paper", "smooth" or the path of a scene file."""
    quality: Literal["draft", "paper", "fine"] | None = None
    """The noise of the records; "paper" if None."""
    walks: int | None = None
    """Random walks at each transport point, instead of a quality: a multiple of 500 from 1,000 on."""
    seed: int | None = None
    """Seed of the random numbers."""
    derivatives: bool | None = None
    """Also compute ∂/∂α and ∂/∂σ_t."""

    def __post_init__(self) -> None:
        # Axes as tuples, so that grids are immutable and can be compared.
        for name in _AXES:
            values = getattr(self, name)
            if values is not None:
                if isinstance(values, str) or not isinstance(values, Iterable):
                    raise TypeError(f"{name}: {values!r}: an axis is a list of numbers")
                object.__setattr__(self, name, tuple(float(value) for value in values))

    def __repr__(self) -> str:
        def text(value: object) -> str:
            return f"<{_display.axis(value)}>" if isinstance(value, tuple) and len(value) > 8 else repr(value)

        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return f"Grid({', '.join(f'{name}={text(value)}' for name, value in given.items() if value is not None)})"

    def to_toml(self) -> str:
        """The grid as a grid file."""
        values_by_name = {field.name: getattr(self, field.name) for field in fields(self)}
        if self.scene is not None and self.scene not in ("lab", "paper", "smooth"):
            # Absolute, since the grid file may lie elsewhere.
            values_by_name["scene"] = str(pathlib.Path(self.scene).resolve())
        return "".join(f"{name} = {_toml(value)}\n" for name, value in values_by_name.items() if value is not None)


_AXES = ("sigma_t_per_mm", "albedo", "g", "thickness_mm", "sample_ior")


def _toml(value: object) -> str:
    if isinstance(value, str | bool | int):
        # Strings of JSON are strings of TOML.
        return json.dumps(value)
    if isinstance(value, tuple):
        return "[" + ", ".join(map(repr, value)) + "]"
    raise TypeError(f"{value!r} is no value of a grid")
