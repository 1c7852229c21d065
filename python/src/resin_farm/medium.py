"""Media, second lobes of their phase functions, and intervals of their coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resin_farm import _display
from resin_farm._wire import fits_pb2, model_pb2

Array = NDArray[np.float64]
"""An array of 64-bit floats."""


@dataclass(frozen=True)
class Medium:
    """A homogeneous medium. The shape of its phase function at this g belongs to the scene: Henyey–Greenstein, two
    lobes (see `SecondLobe`), or a table."""

    sigma_t_per_mm: float
    """Extinction coefficient, in 1/mm."""
    albedo: float
    """Single-scattering albedo."""
    g: float
    """Anisotropy: the mean cosine of the phase function."""

    @property
    def reduced_scattering_per_mm(self) -> float:
        """σ_s (1 − g), in 1/mm."""
        return self.sigma_t_per_mm * self.albedo * (1 - self.g)

    @property
    def absorption_per_mm(self) -> float:
        """σ_a = σ_t (1 − α), in 1/mm."""
        return self.sigma_t_per_mm * (1 - self.albedo)

    def __str__(self) -> str:
        return _display.coefficients(self.sigma_t_per_mm, self.albedo, self.g)

    @classmethod
    def _of_wire(cls, wire: model_pb2.Medium) -> Medium:
        return cls(wire.sigma_t_per_mm, wire.albedo, wire.g)


@dataclass(frozen=True)
class SecondLobe:
    """The second lobe of a two-term Henyey–Greenstein phase function p = (1 − b) HG(g₁) + b HG(g₂), in 1/sr.

    The anisotropy of the medium is the mean cosine, g = (1 − b) g₁ + b g₂.
    """

    weight: float
    """b, from 0 to 0.5."""
    g: float
    """g₂, the anisotropy of this lobe, from −0.999 to 0.999."""

    def first_g(self, g: float) -> float:
        """g₁ = (g − b g₂)/(1 − b), the anisotropy of the first lobe.

        Args:
            g: the anisotropy of the medium.
        """
        return (g - self.weight * self.g) / (1 - self.weight)

    @classmethod
    def _of_wire(cls, wire: model_pb2.SecondLobe) -> SecondLobe:
        return cls(wire.weight, wire.g)

    @classmethod
    def _of_json(cls, found: Mapping[str, Any]) -> SecondLobe:
        return cls(found["weight"], found["g"])


@dataclass(frozen=True)
class Interval:
    """The 95 % confidence interval of a quantity, in its unit; `value in interval` is true if the data allow it."""

    low: float
    """The lower end."""
    high: float
    """The upper end."""
    open_low: bool = False
    """The data allow still lower values: `low` is where the dictionary or the given range ends."""
    open_high: bool = False
    """The data allow still higher values: `high` is where the dictionary or the given range ends."""

    @property
    def is_closed(self) -> bool:
        """Whether the data bound it on both sides."""
        return not (self.open_low or self.open_high)

    def __contains__(self, value: float) -> bool:
        """Whether the data allow a value; an open end allows all beyond it.

        Args:
            value: the value, in the quantity's unit.
        """
        return (self.open_low or self.low <= value) and (self.open_high or value <= self.high)

    def __str__(self) -> str:
        match self.open_low, self.open_high:
            case True, True:
                return "open"
            case True, False:
                return f"≤ {_display.end(self.high)}"
            case False, True:
                return f"≥ {_display.end(self.low)}"
        return "…".join(_display.ends(self.low, self.high)) if self.high > self.low else "held"

    def __repr__(self) -> str:
        return _display.short(self, str(self))

    @classmethod
    def _of_wire(cls, wire: fits_pb2.Interval) -> Interval:
        return cls(wire.low, wire.high, wire.open_low, wire.open_high)

    @classmethod
    def _of_json(cls, found: Mapping[str, Any]) -> Interval:
        return cls(found["low"], found["high"], found["open_low"], found["open_high"])
