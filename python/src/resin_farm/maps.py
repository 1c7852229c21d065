"""Distances between a measurement and every medium of a dictionary."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from resin_farm import _display, _plots
from resin_farm._wire import fits_pb2
from resin_farm.medium import Array, Medium

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# eq=False: the equality of arrays has no single truth value.
@dataclass(frozen=True, eq=False)
class DistanceMap:
    """The distances of one channel, at the refractive index of the best medium."""

    channel: str
    """The channel's name."""
    g: Array
    """Anisotropies: mean cosines of the phase function."""
    sigma_t_per_mm: Array
    """Extinction coefficients, in 1/mm."""
    albedo: Array
    """Single-scattering albedos."""
    errors: Array = field(repr=False)
    """Distances, of the shape (g, σ_t, albedo): Eq. 1, or by the likelihood the root mean square of residuals over
    noise."""
    best: tuple[Medium, ...] = field(repr=False)
    """The best medium at each g."""
    similar: tuple[Medium | None, ...] = field(repr=False)
    """The medium that is similar to the best of all, at each g."""

    def __repr__(self) -> str:
        axes = f"{self.g.size} g × {self.sigma_t_per_mm.size} σ_t × {self.albedo.size} α"
        nearest = self.best[int(self.errors.min(axis=(1, 2)).argmin())]
        return _display.short(self, f"{self.channel}: {axes}, least {_display.number(self.errors.min())} at {nearest}")

    def plot(self) -> Figure:
        """One panel for each g: its best medium as a ring, that of all as a cross, the similar one as a diamond.

        Raises:
            ImportError: if matplotlib is not installed.
        """
        layers = [
            _plots.Layer(f"{self.channel}, g = {g:g}", errors, best, similar)
            for g, errors, best, similar in zip(self.g, self.errors, self.best, self.similar, strict=True)
        ]
        return _plots.distance_map(self.sigma_t_per_mm, self.albedo, layers)

    @classmethod
    def _of_wire(cls, wire: fits_pb2.DistanceMap) -> DistanceMap:
        shape = (len(wire.layers), len(wire.sigma_t_per_mm), len(wire.albedo))
        return cls(
            channel=wire.channel,
            g=np.array([layer.g for layer in wire.layers]),
            sigma_t_per_mm=np.array(wire.sigma_t_per_mm),
            albedo=np.array(wire.albedo),
            errors=np.array([layer.errors for layer in wire.layers]).reshape(shape),
            best=tuple(Medium._of_wire(layer.best.medium) for layer in wire.layers),
            similar=tuple(
                Medium._of_wire(layer.similar) if layer.HasField("similar") else None for layer in wire.layers
            ),
        )
