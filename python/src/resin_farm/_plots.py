"""Draws charts with matplotlib, which is imported when the first chart is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from resin_farm import _optional
from resin_farm.medium import Array, Medium

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours, distinct in all common kinds of colour vision; line styles differ as well.
_COLOURS = {"R": "#d55e00", "G": "#009e73", "B": "#0072b2"}
_STYLES = ("-", "--", ":", "-.")

SIGMA_T = r"$\sigma_t$"


@dataclass(frozen=True, eq=False)
class Line:
    """A profile of one slab: a line, with the measured pixels as points if there are any."""

    thickness_mm: float
    channel: str
    x_mm: Array
    values: Array
    label: str
    points: Array | None = None
    residuals: Array | None = None
    """Points less line, in standard errors of a pixel."""
    left_out: Array | None = None
    """Indices of pixels that the fit leaves out."""


def _colour(channel: str, place: int) -> str:
    return _COLOURS.get(channel, f"C{place}")


def _style(place: int) -> str:
    return _STYLES[place % len(_STYLES)]


def _shown_once(figure: Figure) -> None:
    """Notebooks would show an open figure twice; in scripts `plt.show()` shows the open ones."""
    import matplotlib
    import matplotlib.pyplot as plt

    if "inline" in matplotlib.get_backend():
        plt.close(figure)


def _panels(titles: list[str], lower: str | None = None) -> tuple[Figure, Any]:
    """A row of panels, and with the name of a lower axis a row of lower ones below it."""
    _optional.require("plot", "matplotlib")
    import matplotlib.pyplot as plt

    rows = 1 if lower is None else 2
    figure, axes = plt.subplots(
        rows,
        len(titles),
        figsize=(max(5.0, 4.0 * len(titles)), 3.4 if lower is None else 4.6),
        sharex=True,
        sharey="row",
        squeeze=False,
        height_ratios=[2, 1][:rows],
        layout="constrained",
    )
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, fontsize=10)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
    for axis in axes[-1]:
        axis.set_xlabel("x [mm]")
    axes[0][0].set_ylabel("radiance factor")
    if lower is not None:
        axes[1][0].set_ylabel(lower)
    _shown_once(figure)
    return figure, axes


def profile(title: str, x_mm: Array, channels: Mapping[str, Array], std_errors: Mapping[str, Array]) -> Figure:
    """The channels of one profile, with bands of two standard errors."""
    figure, ((axis,),) = _panels([title])
    for place, (channel, values) in enumerate(channels.items()):
        colour = _colour(channel, place)
        axis.plot(x_mm, values, _style(place), color=colour, label=channel, linewidth=1.2)
        if channel in std_errors:
            error = 2 * std_errors[channel]
            axis.fill_between(x_mm, values - error, values + error, color=colour, alpha=0.2, linewidth=0)
    axis.legend(frameon=False)
    return figure


def slabs(material: str, lines: Sequence[Line]) -> Figure:
    """The profiles of a material, one panel for each thickness; residuals of fits below."""
    thicknesses = sorted({line.thickness_mm for line in lines})
    channels = list(dict.fromkeys(line.channel for line in lines))
    has_residuals = any(line.residuals is not None for line in lines)
    figure, axes = _panels([f"{material}, {t:g} mm" for t in thicknesses], "residual [σ]" if has_residuals else None)
    for line in lines:
        column, place = thicknesses.index(line.thickness_mm), channels.index(line.channel)
        axis, colour = axes[0][column], _colour(line.channel, place)
        if line.points is not None:
            axis.plot(line.x_mm, line.points, ".", color=colour, markersize=2.5, alpha=0.5)
        axis.plot(line.x_mm, line.values, _style(place), color=colour, label=line.label, linewidth=1.2)
        if line.residuals is not None:
            _residuals(axes[1][column], line, colour)
    axes[0][-1].legend(frameon=False)
    return figure


def _residuals(axis: Any, line: Line, colour: str) -> None:
    axis.plot(line.x_mm, line.residuals, ".", color=colour, markersize=2.5)
    if line.left_out is not None and line.residuals is not None and line.left_out.size:
        x_mm, residuals = line.x_mm[line.left_out], np.clip(line.residuals[line.left_out], -6, 6)
        axis.plot(x_mm, residuals, "x", color="black", markersize=4)
    for level in (-2, 2):
        axis.axhline(level, color="black", linewidth=0.6, linestyle="--")
    axis.set_ylim(-6, 6)


def scale(mu: Array, error: Array, best_mu: float) -> Figure:
    """The aggregate error over the scale factor."""
    figure, ((axis,),) = _panels(["aggregate error by the scale factor (Eq. 3)"])
    axis.plot(mu, error, color="black", linewidth=1.2)
    axis.axvline(best_mu, color="#d55e00", linewidth=0.8, label=f"μ = {best_mu:.3f}")
    axis.set_xlabel("μ")
    axis.set_ylabel("error")
    axis.legend(frameon=False)
    return figure


@dataclass(frozen=True, eq=False)
class Layer:
    """The distances at one anisotropy, over σ_t and albedo."""

    title: str
    errors: Array
    best: Medium
    similar: Medium | None


def distance_map(sigma_t_per_mm: Array, albedo: Array, layers: Sequence[Layer]) -> Figure:
    """One panel for each anisotropy: the best medium as a ring, that of all panels as a cross, the similar one as a
    diamond; bright is near."""
    _optional.require("plot", "matplotlib")
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    columns = min(4, len(layers))
    rows = -(-len(layers) // columns)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(2.6 * columns, 2.3 * rows + 0.3),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    _shown_once(figure)
    least = min(layer.errors.min() for layer in layers)
    norm = LogNorm(least, min(max(layer.errors.max() for layer in layers), 100 * least))
    # A dictionary may hold an albedo of 1, which has no logarithm.
    missing = np.maximum(1 - albedo, 1e-6)
    for axis, layer in zip(axes.flat, layers, strict=False):
        mesh = axis.pcolormesh(missing, sigma_t_per_mm, layer.errors, norm=norm, cmap="viridis_r", shading="nearest")
        place = max(1 - layer.best.albedo, 1e-6), layer.best.sigma_t_per_mm
        axis.plot(*place, "o", mfc="none", color="black", label="best at this g")
        if layer.errors.min() == least:
            axis.plot(*place, "x", color="black", label="best of all")
        if layer.similar is not None:
            similar = layer.similar
            place = max(1 - similar.albedo, 1e-6), similar.sigma_t_per_mm
            axis.plot(*place, "D", mfc="none", color="black", label="similar to the best of all")
        axis.set(xscale="log", yscale="log")
        axis.set_title(layer.title, fontsize=10)
        axis.set_ylim(sigma_t_per_mm[0], sigma_t_per_mm[-1])
    _label_lowest(axes, len(layers), "1 − α")
    for axis in axes[:, 0]:
        axis.set_ylabel(f"{SIGMA_T} [1/mm]")
    figure.colorbar(mesh, ax=axes, label="distance", shrink=0.8)
    marks = {
        label: handle for axis in axes.flat for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend([*marks.values()], [*marks], loc="outside lower center", ncols=3, frameon=False)
    return figure


def _label_lowest(axes: Any, count: int, label: str) -> None:
    """Labels the lowest of `count` panels in each column, and hides the panels that are left."""
    columns = axes.shape[1]
    for place, axis in enumerate(axes.flat):
        if place >= count:
            axis.set_visible(False)
        elif place + columns >= count:
            axis.set_xlabel(label)
            axis.tick_params(labelbottom=True)
