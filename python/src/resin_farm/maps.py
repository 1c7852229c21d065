"""How far a measurement is from every medium of a dictionary."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resin_farm._wire import fits_pb2
from resin_farm.results import Medium

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


# Arrays have no truth value of their equality.
@dataclass(frozen=True, eq=False)
class DistanceMap:
    """The distances of one channel, at the refractive index of the best medium."""

    channel: str
    g: Array
    sigma_t_per_mm: Array
    albedo: Array
    errors: Array = field(repr=False)
    """Over g, σ_t and albedo: Eq. 1 of the paper; by the likelihood the root mean square of residuals over noise."""
    best: tuple[Medium, ...] = field(repr=False)
    """The best medium at each g."""
    similar: tuple[Medium | None, ...] = field(repr=False)
    """What similarity theory makes of the best of all, at each g."""

    def plot(self) -> Figure:
        """One panel for each g: the best medium as a cross, the similar one as a ring."""
        from resin_farm import _plots

        return _plots.distance_map(self)

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
