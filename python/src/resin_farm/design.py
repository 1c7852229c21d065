"""The precision with which sets of slabs would determine a medium, before they are photographed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from resin_farm import _display, _optional
from resin_farm._wire import fits_pb2
from resin_farm.medium import Medium

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class HalfWidths:
    """Half of the widths of 95 % intervals; infinite where the pixels hold no information."""

    sigma_t_per_mm: float
    """Half-width of the extinction coefficient, in 1/mm."""
    albedo: float
    """Half-width of the single-scattering albedo."""
    g: float
    """Half-width of the anisotropy, the mean cosine of the phase function."""
    reduced_scattering_per_mm: float
    """Half-width of σ_s (1 − g), in 1/mm."""
    absorption_per_mm: float
    """Half-width of σ_a, in 1/mm."""

    def __repr__(self) -> str:
        sigma_t, alpha, g = map(_display.number, (self.sigma_t_per_mm, self.albedo, self.g))
        return _display.short(self, f"σ_t ± {sigma_t} /mm, α ± {alpha}, g ± {g}")

    @classmethod
    def _of_wire(cls, wire: fits_pb2.HalfWidths) -> HalfWidths:
        return cls(wire.sigma_t_per_mm, wire.albedo, wire.g, wire.reduced_scattering_per_mm, wire.absorption_per_mm)


@dataclass(frozen=True)
class SlabSet:
    """A set of slabs, and how well photographs of it would determine the medium (Cramér–Rao bounds)."""

    slabs_mm: tuple[float, ...]
    """Thicknesses of the slabs, in mm."""
    shots: int
    """Photographs of each slab."""
    g_held: HalfWidths
    """With a known anisotropy."""
    g_free: HalfWidths | None
    """With the anisotropy estimated from the same pixels; None if the dictionary has only one."""
    best: bool
    """No other set determines σ_t and 1 − α together better, g held."""
    best_of_its_effort: bool
    """No other set of at most as many photographs determines them better."""

    def __repr__(self) -> str:
        widths = f"σ_t ± {_display.number(self.g_held.sigma_t_per_mm)} /mm, α ± {_display.number(self.g_held.albedo)}"
        best = ", the best" if self.best else ""
        return _display.short(self, f"{_slabs(self)}, {self.shots} shots{best}: {widths}, g held")


@dataclass(frozen=True)
class Design:
    """Sets of slabs, in the order of the request. Iteration yields the sets."""

    medium: Medium
    """The medium that was guessed."""
    channel: str
    """The channel's name."""
    sets: tuple[SlabSet, ...]
    """The sets of slabs."""

    @property
    def best(self) -> SlabSet:
        """The set that determines σ_t and 1 − α together best, g held."""
        return next(one for one in self.sets if one.best)

    def __iter__(self) -> Iterator[SlabSet]:
        """The sets of slabs."""
        return iter(self.sets)

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each set: slabs, shots, half-widths of σ_t and 1 − α as shares of them, g held and free, and the
        half-width of g.

        Raises:
            ImportError: if pandas is not installed.
        """
        _optional.require("data", "pandas")
        import pandas

        return pandas.DataFrame([self._record(one) for one in self.sets])

    def _record(self, one: SlabSet) -> dict[str, object]:
        m, free = self.medium, one.g_free
        return {
            "slabs_mm": one.slabs_mm,
            "shots": one.shots,
            "sigma_t_share": one.g_held.sigma_t_per_mm / m.sigma_t_per_mm,
            "one_minus_albedo_share": one.g_held.albedo / (1 - m.albedo),
            "sigma_t_share_g_free": free.sigma_t_per_mm / m.sigma_t_per_mm if free else float("nan"),
            "one_minus_albedo_share_g_free": free.albedo / (1 - m.albedo) if free else float("nan"),
            "g_half_width": free.g if free else float("nan"),
            "best": one.best,
        }

    def __str__(self) -> str:
        return _display.text_table(_HEAD, self._rows())

    def __repr__(self) -> str:
        best = f"{_slabs(self.best)}, {self.best.shots} shots" if any(one.best for one in self.sets) else "none"
        return _display.short(self, f"{self.channel}, {self.medium}: {len(self.sets)} sets of slabs, the best {best}")

    def _repr_html_(self) -> str:
        caption = f"channel {self.channel}, {self.medium}: half-widths of 95 % intervals"
        marked = [place for place, one in enumerate(self.sets) if not math.isfinite(one.g_held.sigma_t_per_mm)]
        return _display.html_table(_HEAD, self._rows(), caption, marked)

    def _rows(self) -> list[list[str]]:
        def row(one: SlabSet) -> list[str]:
            record = self._record(one)
            shares = [
                f"{100 * share:.2g} %"
                for share in (record["sigma_t_share"], record["one_minus_albedo_share"])
                if isinstance(share, float)
            ]
            free = f"{one.g_free.g:.2g}" if one.g_free else ""
            return [
                " + ".join(f"{t:g}" for t in one.slabs_mm),
                "best" if one.best else "",
                str(one.shots),
                *shares,
                free,
            ]

        return [row(one) for one in self.sets]


def _slabs(one: SlabSet) -> str:
    return " + ".join(f"{t:g}" for t in one.slabs_mm) + " mm"


_HEAD = ("slabs / mm", "", "shots", "σ_t", "1 − α", "g, free")


def of_wire(wire: fits_pb2.DesignResponse) -> Design:
    sets = tuple(
        SlabSet(
            slabs_mm=tuple(one.slabs_mm),
            shots=one.shots,
            g_held=HalfWidths._of_wire(one.g_held),
            g_free=HalfWidths._of_wire(one.g_free) if one.HasField("g_free") else None,
            best=one.best,
            best_of_its_effort=one.best_of_its_effort,
        )
        for one in wire.sets
    )
    return Design(Medium._of_wire(wire.medium), wire.channel, sets)
