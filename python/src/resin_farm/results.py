"""Answers of fits: the media of one material, and of several that were measured together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from resin_farm import _display, _optional, _plots, _remarks
from resin_farm.channel_fit import ChannelFit
from resin_farm.medium import Array, Interval, SecondLobe

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


# eq=False: the equality of arrays has no single truth value.
@dataclass(frozen=True, eq=False)
class ScaleCurve:
    """The aggregate error of a set of materials over the scale factor (Eq. 3 of the paper), by the best records."""

    mu: Array = field(repr=False)
    """Scale factors that were tried, rising."""
    error: Array = field(repr=False)
    """The aggregate error at each of them."""
    best_mu: float
    """The scale factor with the least error."""
    std_error: float | None
    """Standard error of `best_mu`, by leaving out one channel after the other; None for one channel."""
    best_g: float
    """The anisotropy (mean cosine) with the least error common to all materials."""

    def __repr__(self) -> str:
        best = (
            _display.number(self.best_mu) if self.std_error is None else _display.estimate(self.best_mu, self.std_error)
        )
        span = f"{self.mu.size} values from {self.mu[0]:g} to {self.mu[-1]:g}" if self.mu.size else "no values"
        return _display.short(self, f"μ = {best}, best of {span}; g = {_display.number(self.best_g)}")

    def plot(self) -> Figure:
        """The curve, with its minimum.

        Raises:
            ImportError: if matplotlib is not installed.
        """
        return _plots.scale(self.mu, self.error, self.best_mu)


_HEAD = ("material", "ch", "σ_s(1−g)", "95 %", "σ_a", "95 %", "σ_t /mm", "95 %", "α", "95 %", "g", "95 %", "misfit")


@dataclass(frozen=True)
class MaterialFit:
    """The media of a material, one for each channel. `fit["R"]` is that of a channel."""

    material: str
    """The material's name."""
    channels: tuple[ChannelFit, ...]
    """The fits of its channels."""
    assumed: tuple[str, ...] = field(default=(), repr=False)
    """Options that have their defaults, for at least one profile."""

    def __getitem__(self, channel: str) -> ChannelFit:
        """The fit of a channel.

        Args:
            channel: its name.

        Raises:
            KeyError: if there is no such channel; it lists those that there are.
        """
        for fit in self.channels:
            if fit.channel == channel:
                return fit
        raise KeyError(f"{channel}: the channels are {', '.join(fit.channel for fit in self.channels)}")

    def __str__(self) -> str:
        return "\n".join([_display.text_table(_HEAD, self._rows()), *self._notes()])

    def __repr__(self) -> str:
        channels = [f"{fit.channel} {_sigma_t(fit)}" for fit in self.channels]
        return _display.short(self, f"{self.material}: σ_t in 1/mm: {_display.names(channels)}")

    def _repr_html_(self) -> str:
        return _html([self]) + _display.html_lines(self._notes())

    @property
    def remarks(self) -> list[str]:
        """Remarks on the channels that affect how they may be used."""
        return [remark for fit in self.channels for remark in _remarks.of_channel(self.material, fit)]

    def _notes(self) -> list[str]:
        return self.remarks + _remarks.of_assumed(self.assumed, self.channels)

    def _rows(self) -> list[list[str]]:
        return [_row(self.material, fit) for fit in self.channels]

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each channel: parameters, ends of intervals (NaN where open), misfit, weight and anisotropy of
        the second lobe (NaN if the phase function has none). g is the mean cosine of the phase function.

        Raises:
            ImportError: if pandas is not installed.
        """
        _optional.require("data", "pandas")
        import pandas

        return pandas.DataFrame([_record(self.material, fit) for fit in self.channels])

    def to_mitsuba(self) -> dict[str, Any]:
        """The medium as a dictionary for Mitsuba 3, of channels R, G and B with the same phase function; coefficients
        are per mm. The phase function has the second lobe of the continuous optimum; without an optimum it is
        Henyey–Greenstein.

        Raises:
            ValueError: if it has other channels, or if their phase functions differ: a homogeneous medium has one. Hold
                g, take `phase="henyey_greenstein"`, or let `farmctl measure -o` write separate media.
        """
        media = {fit.channel: fit.medium for fit in self.channels}
        if sorted(media) != ["B", "G", "R"]:
            raise ValueError(f"R, G and B are needed, and the channels are {', '.join(media)}")
        rgb = [media[channel] for channel in "RGB"]
        if len({medium.g for medium in rgb}) > 1:
            raise ValueError(f"one g is needed, and these are {', '.join(_display.number(m.g) for m in rgb)}: hold it")
        lobes = [self[channel].second_lobe for channel in "RGB"]
        if len(set(lobes)) > 1:
            weights = ", ".join(_display.number(lobe.weight if lobe else 0) for lobe in lobes)
            raise ValueError(f"one second lobe is needed, and their weights are {weights}: write separate media")
        # An rgb value above 1 is an error in Mitsuba.
        scale = 10.0 ** max(0, math.ceil(math.log10(max(medium.sigma_t_per_mm for medium in rgb))))
        return {
            "type": "homogeneous",
            "sigma_t": {"type": "rgb", "value": [medium.sigma_t_per_mm / scale for medium in rgb]},
            "albedo": {"type": "rgb", "value": [medium.albedo for medium in rgb]},
            "scale": scale,
            "phase": _mitsuba_phase(rgb[0].g, lobes[0]),
        }

    def plot(self) -> Figure:
        """Measured profiles with their fits, and residuals below.

        Raises:
            ValueError: if there are no curves; `curves=True` requests them.
            ImportError: if matplotlib is not installed.
        """
        lines = [
            _plots.Line(
                curves.thickness_mm,
                fit.channel,
                curves.x_mm,
                curves.refined if curves.refined is not None else curves.best_record,
                f"{fit.channel} fit",
                curves.measured,
                curves.residuals,
                curves.left_out,
            )
            for fit in self.channels
            for curves in fit.curves
        ]
        if not lines:
            raise ValueError("there are no curves to draw: ask for the fit with curves=True")
        return _plots.slabs(self.material, lines)


@dataclass(frozen=True)
class Measured:
    """A set of materials, measured together. `measured["white"]` is the fit of a material."""

    materials: tuple[MaterialFit, ...]
    """The fits of the materials."""
    mu: float
    """Factor on all measured values."""
    mu_std_error: float
    """Its standard error."""
    mu_chosen: bool
    """Whether it was estimated, not given."""
    g: float | None
    """The anisotropy, the mean cosine of the phase function, as a mean over the materials; None if every channel has
    its own, or each wavelength."""
    g_interval: Interval | None
    """Its interval; None if there is none."""
    dictionary: str
    """The name of the dictionary."""
    scale: ScaleCurve | None = field(default=None, repr=False)
    """The error of the best records over the scale factor, with the paper's objective; None with the likelihood, and
    if μ was given."""
    assumed: tuple[str, ...] = field(default=(), repr=False)
    """Options that have their defaults, for at least one profile."""

    def __getitem__(self, material: str) -> MaterialFit:
        """The fit of a material.

        Args:
            material: its name.

        Raises:
            KeyError: if there is no such material; it lists those that there are.
        """
        for fit in self.materials:
            if fit.material == material:
                return fit
        raise KeyError(f"{material}: the materials are {', '.join(fit.material for fit in self.materials)}")

    def __str__(self) -> str:
        return "\n".join([self._common(), "", _display.text_table(_HEAD, self._rows()), *self._notes()])

    def __repr__(self) -> str:
        fits = [channel for fit in self.materials for channel in fit.channels]
        unresolved = sum(_state(fit) == "unresolved" for fit in fits)
        counts = f"{len(fits)} channels, {unresolved} unresolved"
        materials = _display.names([fit.material for fit in self.materials])
        common = f"μ {_display.estimate(self.mu, self.mu_std_error)}"
        common += "" if self.g is None else f", g {_display.number(self.g)}"
        return _display.short(self, f"{materials}: {counts}; {common}; dictionary {self.dictionary}")

    def _repr_html_(self) -> str:
        return _html(self.materials, self._common()) + _display.html_lines(self._notes())

    @property
    def remarks(self) -> list[str]:
        """Remarks on the channels that affect how they may be used."""
        return [remark for fit in self.materials for remark in fit.remarks]

    def _notes(self) -> list[str]:
        channels = [channel for fit in self.materials for channel in fit.channels]
        return self.remarks + _remarks.of_assumed(self.assumed, channels)

    def _rows(self) -> list[list[str]]:
        return [_row(fit.material, channel) for fit in self.materials for channel in fit.channels]

    def _common(self) -> str:
        how = "chosen with all channels together" if self.mu_chosen else "given"
        line = f"scale factor μ = {self.mu:.3f} ± {self.mu_std_error:.3f}, {how}"
        if self.g is not None:
            interval = f" (95 %: {self.g_interval})" if self.g_interval else ""
            line += f"; anisotropy g = {self.g:.3g}{interval}"
        return line

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each channel of each material, with the columns of `MaterialFit.to_pandas`.

        Raises:
            ImportError: if pandas is not installed.
        """
        _optional.require("data", "pandas")
        import pandas

        return pandas.concat([fit.to_pandas() for fit in self.materials], ignore_index=True)

    def to_xarray(self) -> xarray.Dataset:
        """The columns of `to_pandas` over material and `wavelength_nm`, rising, if all channels are wavelengths, and
        over material and `channel` if not. A channel that a material lacks has no value there.

        Raises:
            ImportError: if pandas or xarray is not installed.
        """
        _optional.require("data", "pandas", "xarray")
        frame, axis = self.to_pandas(), "channel"
        wavelengths = [_wavelength_nm(channel) for channel in frame["channel"]]
        if not any(math.isnan(wavelength) for wavelength in wavelengths):
            axis, frame = "wavelength_nm", frame.drop(columns="channel").assign(wavelength_nm=wavelengths)
        order = frame[axis].unique() if axis == "channel" else sorted(frame[axis].unique())
        dataset = frame.set_index(["material", axis]).to_xarray()
        return dataset.sel({"material": frame["material"].unique(), axis: order})


def _wavelength_nm(channel: str) -> float:
    """The wavelength that a channel's name is, with or without its unit; NaN for other names."""
    try:
        wavelength = float(channel.strip().removesuffix("nm"))
    except ValueError:
        return math.nan
    return wavelength if 100 <= wavelength <= 20_000 else math.nan


def _row(material: str, fit: ChannelFit) -> list[str]:
    m, n = fit.medium, _display.number
    if fit.refined is None:
        values = [n(m.reduced_scattering_per_mm), n(m.absorption_per_mm), n(m.sigma_t_per_mm)]
        cells = [cell for value in [*values, _display.albedo(m.albedo), n(m.g)] for cell in (value, "")]
        return [material, fit.channel, *cells, ""]
    r = fit.refined
    cells = [n(m.reduced_scattering_per_mm), str(r.reduced_scattering_per_mm)]
    cells += [n(m.absorption_per_mm), str(r.absorption_per_mm), n(m.sigma_t_per_mm), str(r.sigma_t_per_mm)]
    cells += [_display.albedo(m.albedo), str(r.albedo), n(m.g), str(r.g), f"{r.misfit:.1f}"]
    return [material, fit.channel, *cells]


def _state(fit: ChannelFit) -> str:
    """Whether the data determine the medium of a channel; empty without a continuous optimum."""
    if fit.outside is not None:
        return "outside"
    if fit.refined is None:
        return ""
    if not fit.refined.resolved_at_g:
        return "unresolved"
    return "resolved" if fit.refined.resolved else "g open"


def _sigma_t(fit: ChannelFit) -> str:
    """σ_t with its interval, and the state of the channel unless it is resolved."""
    interval = f" ({fit.refined.sigma_t_per_mm})" if fit.refined else ""
    state = _state(fit)
    return (
        _display.number(fit.medium.sigma_t_per_mm) + interval + (f" {state}" if state not in ("", "resolved") else "")
    )


def _html(materials: Sequence[MaterialFit], caption: str = "") -> str:
    """The table of a notebook, with the state of each channel; those that are unresolved are marked."""
    rows = [[*_row(fit.material, channel), _state(channel)] for fit in materials for channel in fit.channels]
    marked = [place for place, row in enumerate(rows) if row[-1] in ("unresolved", "outside")]
    return _display.html_table((*_HEAD, "state"), rows, caption, marked)


def _mitsuba_phase(g: float, second: SecondLobe | None) -> dict[str, Any]:
    """Henyey–Greenstein, or a blend of two, whose weight is that of the second."""
    if second is None:
        return {"type": "hg", "g": g}
    return {
        "type": "blendphase",
        "weight": second.weight,
        "first": {"type": "hg", "g": second.first_g(g)},
        "second": {"type": "hg", "g": second.g},
    }


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
    row["second_lobe_weight"] = fit.second_lobe.weight if fit.second_lobe else np.nan
    row["second_lobe_g"] = fit.second_lobe.g if fit.second_lobe else np.nan
    return row
