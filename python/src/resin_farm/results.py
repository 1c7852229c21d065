"""Answers of fits, as dataclasses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resin_farm import _display, _remarks
from resin_farm._wire import fits_pb2, model_pb2

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Medium:
    """A homogeneous medium with a Henyey–Greenstein phase function."""

    sigma_t_per_mm: float
    """Extinction coefficient, in 1/mm."""
    albedo: float
    """Single-scattering albedo."""
    g: float
    """Anisotropy."""

    @property
    def reduced_scattering_per_mm(self) -> float:
        """σ_s (1 − g), in 1/mm."""
        return self.sigma_t_per_mm * self.albedo * (1 - self.g)

    @property
    def absorption_per_mm(self) -> float:
        """σ_a = σ_t (1 − α), in 1/mm."""
        return self.sigma_t_per_mm * (1 - self.albedo)

    @classmethod
    def _of_wire(cls, wire: model_pb2.Medium) -> Medium:
        return cls(wire.sigma_t_per_mm, wire.albedo, wire.g)


@dataclass(frozen=True)
class Interval:
    """Where a quantity lies with a confidence of 95 %."""

    low: float
    high: float
    open_low: bool = False
    """The data allow still lower values: `low` is where the dictionary or the given range ends."""
    open_high: bool = False

    @property
    def is_closed(self) -> bool:
        return not (self.open_low or self.open_high)

    def __contains__(self, value: float) -> bool:
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

    @classmethod
    def _of_wire(cls, wire: fits_pb2.Interval) -> Interval:
        return cls(wire.low, wire.high, wire.open_low, wire.open_high)

    @classmethod
    def _of_json(cls, found: Mapping[str, Any]) -> Interval:
        return cls(found["low"], found["high"], found["open_low"], found["open_high"])


@dataclass(frozen=True)
class Candidate:
    """A record that was compared."""

    medium: Medium
    sample_ior: float
    error: float
    """The objective that was made least: Eq. 1 of the paper, or by the likelihood the misfit."""
    records: tuple[int | None, ...]
    """Numbers of its records in the dictionary, one for each thickness."""


@dataclass(frozen=True)
class NuisanceEstimate:
    """What the data say of something that is wrong with every set-up, and what was known before."""

    name: str
    """`scale`, `blur_variance_mm2`, `thickness_mm`, `origin_mm`, `gain`, `zero` or `slope`."""
    profile_mm: float | None
    """The profile concerned, by its thickness; None if all are."""
    value: float
    std_error: float
    prior: float
    prior_std_error: float | None
    """None if nothing was known."""


@dataclass(frozen=True)
class SourceShare:
    """Shares of the variances of ln σ_t, √(1 - α), ln σ_s(1 - g) and √σ_a that a source of error makes: 1 in all."""

    source: str
    """`noise`, `dictionary`, `thickness`, `origin`, `blur`, `gain`, `zero`, `slope`, `scale`, `other_channels`, `g`."""
    sigma_t: float
    albedo: float
    reduced_scattering: float
    absorption: float


@dataclass(frozen=True)
class Likelihood:
    """What the likelihood tells of a channel beside its medium."""

    chi2: float
    degrees_of_freedom: float
    probability: float
    """That noise alone makes χ² as large."""
    nuisances: tuple[NuisanceEstimate, ...]
    outliers: int
    """Pixels that were given no weight."""
    budget: tuple[SourceShare, ...] = ()
    """What the variances of the medium are made of; empty if the data determine nothing."""


# Arrays have no truth value of their equality.
@dataclass(frozen=True, eq=False)
class Refined:
    """A continuous optimum, with error bars of 95 %."""

    medium: Medium
    sigma_t_per_mm: Interval
    albedo: Interval
    g: Interval
    reduced_scattering_per_mm: Interval
    absorption_per_mm: Interval
    resolved: bool
    """Whether the data determine σ_t and the albedo: both intervals are bounded and narrow."""
    resolved_at_g: bool
    """Whether they would with g held at its best value; if this alone is true, g is open."""
    valley: bool
    """σ_t and g trade off along media that similarity theory calls equal."""
    misfit: float
    """Root mean square of the residuals over the noise: 1 if noise explains all."""
    error: float
    covariance: Array = field(repr=False)
    """Of (ln σ_t, √(1 − α), ln(1 − g)); zeros where a parameter was held."""
    suspicion: str | None = None
    """The likeliest single reason why the fit leaves more than noise explains."""
    likelihood: Likelihood | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class Curves:
    """What was compared at one thickness."""

    thickness_mm: float
    x_mm: Array
    measured: Array
    """Times μ, on the dictionary's pixels."""
    best_record: Array
    refined: Array | None


@dataclass(frozen=True)
class ChannelFit:
    """One channel of a material."""

    channel: str
    candidates: tuple[Candidate, ...]
    refined: Refined | None
    outside: str | None
    """`brighter` or `darker`, if a profile's mean lies beyond that of every record."""
    curves: tuple[Curves, ...] = field(default=(), repr=False)

    @property
    def medium(self) -> Medium:
        """The continuous optimum; without one the best record's medium."""
        return self.refined.medium if self.refined else self.candidates[0].medium


# Arrays have no truth value of their equality.
@dataclass(frozen=True, eq=False)
class ScaleCurve:
    """The aggregate error of a set of materials over the scale factor (Eq. 3 of the paper), by the best records."""

    mu: Array = field(repr=False)
    error: Array = field(repr=False)
    best_mu: float
    std_error: float | None
    """Of `best_mu`, by leaving out one channel after the other; None for one."""
    best_g: float
    """The anisotropy with the least error common to all materials."""

    def plot(self) -> Figure:
        from resin_farm import _plots

        return _plots.scale(self)


_HEAD = ("material", "ch", "σ_t /mm", "95 %", "α", "95 %", "g", "95 %", "σ_s(1−g)", "95 %", "σ_a", "95 %", "misfit")


@dataclass(frozen=True)
class MaterialFit:
    """The media of a material, one for each channel."""

    material: str
    channels: tuple[ChannelFit, ...]
    assumed: tuple[str, ...] = field(default=(), repr=False)
    """Options that nobody told, of one profile at least: they have their defaults."""

    def __getitem__(self, channel: str) -> ChannelFit:
        for fit in self.channels:
            if fit.channel == channel:
                return fit
        raise KeyError(f"{channel}: the channels are {', '.join(fit.channel for fit in self.channels)}")

    def __str__(self) -> str:
        return "\n".join([_display.text_table(_HEAD, self._rows()), *self._notes()])

    def _repr_html_(self) -> str:
        return _display.html_table(_HEAD, self._rows()) + _display.html_lines(self._notes())

    @property
    def remarks(self) -> list[str]:
        """What must be known of the channels before they are used: none if all is well."""
        return [remark for fit in self.channels for remark in _remarks.of_channel(self.material, fit)]

    def _notes(self) -> list[str]:
        return self.remarks + _remarks.of_assumed(self.assumed, self.channels)

    def _rows(self) -> list[list[str]]:
        return [_row(self.material, fit) for fit in self.channels]

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each channel: parameters, ends of intervals (NaN where open), misfit."""
        import pandas

        return pandas.DataFrame([_record(self.material, fit) for fit in self.channels])

    def to_mitsuba(self) -> dict[str, Any]:
        """The medium as a dictionary for Mitsuba 3, of channels R, G and B with the same g; coefficients are per mm.

        Raises:
            ValueError: if it has other channels, or if their anisotropies differ: a homogeneous medium has one phase
                function. Hold g, or let `farmctl measure -o` write media of their own.
        """
        media = {fit.channel: fit.medium for fit in self.channels}
        if sorted(media) != ["B", "G", "R"]:
            raise ValueError(f"R, G and B are needed, and the channels are {', '.join(media)}")
        rgb = [media[channel] for channel in "RGB"]
        if len({medium.g for medium in rgb}) > 1:
            raise ValueError(f"one g is needed, and these are {', '.join(_display.number(m.g) for m in rgb)}: hold it")
        # An rgb value above 1 is an error in Mitsuba.
        scale = 10.0 ** max(0, math.ceil(math.log10(max(medium.sigma_t_per_mm for medium in rgb))))
        return {
            "type": "homogeneous",
            "sigma_t": {"type": "rgb", "value": [medium.sigma_t_per_mm / scale for medium in rgb]},
            "albedo": {"type": "rgb", "value": [medium.albedo for medium in rgb]},
            "scale": scale,
            "phase": {"type": "hg", "g": rgb[0].g},
        }

    def plot(self) -> Figure:
        """Measured profiles with their fits; needs curves, which `curves=True` asks for."""
        from resin_farm import _plots

        return _plots.fits(self)


@dataclass(frozen=True)
class Measured:
    """A set of materials, measured together."""

    materials: tuple[MaterialFit, ...]
    mu: float
    """Factor on all measured values."""
    mu_std_error: float
    mu_chosen: bool
    """Searched for, not given."""
    g: float | None
    """The common anisotropy; None if every channel has its own."""
    g_interval: Interval | None
    dictionary: str
    scale: ScaleCurve | None = field(default=None, repr=False)
    """None if μ was given."""
    assumed: tuple[str, ...] = field(default=(), repr=False)
    """Options that nobody told, of one profile at least: they have their defaults."""

    def __getitem__(self, material: str) -> MaterialFit:
        for fit in self.materials:
            if fit.material == material:
                return fit
        raise KeyError(f"{material}: the materials are {', '.join(fit.material for fit in self.materials)}")

    def __str__(self) -> str:
        return "\n".join([self._common(), "", _display.text_table(_HEAD, self._rows()), *self._notes()])

    def _repr_html_(self) -> str:
        return _display.html_table(_HEAD, self._rows(), self._common()) + _display.html_lines(self._notes())

    @property
    def remarks(self) -> list[str]:
        """What must be known of the channels before they are used: none if all is well."""
        return [remark for fit in self.materials for remark in fit.remarks]

    def _notes(self) -> list[str]:
        channels = [channel for fit in self.materials for channel in fit.channels]
        return self.remarks + _remarks.of_assumed(self.assumed, channels)

    def _rows(self) -> list[list[str]]:
        return [_row(fit.material, channel) for fit in self.materials for channel in fit.channels]

    def _common(self) -> str:
        how = "chosen with all channels together" if self.mu_chosen else "given"
        told = f"scale factor μ = {self.mu:.3f} ± {self.mu_std_error:.3f}, {how}"
        if self.g is not None:
            interval = f" (95 %: {self.g_interval})" if self.g_interval else ""
            told += f"; anisotropy g = {self.g:.3g}{interval}"
        return told

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each channel of each material."""
        import pandas

        return pandas.concat([fit.to_pandas() for fit in self.materials], ignore_index=True)


def _row(material: str, fit: ChannelFit) -> list[str]:
    m, n = fit.medium, _display.number
    if fit.refined is None:
        values = [n(m.sigma_t_per_mm), _display.albedo(m.albedo), n(m.g), n(m.reduced_scattering_per_mm)]
        told = [cell for value in [*values, n(m.absorption_per_mm)] for cell in (value, "")]
        return [material, fit.channel, *told, ""]
    r = fit.refined
    cells = [n(m.sigma_t_per_mm), str(r.sigma_t_per_mm), _display.albedo(m.albedo), str(r.albedo)]
    cells += [n(m.g), str(r.g), n(m.reduced_scattering_per_mm), str(r.reduced_scattering_per_mm)]
    cells += [n(m.absorption_per_mm), str(r.absorption_per_mm), f"{r.misfit:.1f}"]
    return [material, fit.channel, *cells]


_QUANTITIES = ("sigma_t_per_mm", "albedo", "g", "reduced_scattering_per_mm", "absorption_per_mm")


def _record(material: str, fit: ChannelFit) -> dict[str, Any]:
    row: dict[str, Any] = {"material": material, "channel": fit.channel}
    for name in _QUANTITIES:
        row[name] = getattr(fit.medium, name)
        interval = getattr(fit.refined, name) if fit.refined else Interval(np.nan, np.nan)
        row[f"{name}_low"] = np.nan if interval.open_low else interval.low
        row[f"{name}_high"] = np.nan if interval.open_high else interval.high
    row["resolved"] = fit.refined.resolved if fit.refined else None
    row["resolved_at_g"] = fit.refined.resolved_at_g if fit.refined else None
    row["misfit"] = fit.refined.misfit if fit.refined else np.nan
    return row
