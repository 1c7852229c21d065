"""Pictures, by matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from resin_farm.maps import DistanceMap
    from resin_farm.measurement import Measurement
    from resin_farm.profile import Profile
    from resin_farm.results import MaterialFit, ScaleCurve

_COLOURS = {"R": "#c0392b", "G": "#27803b", "B": "#2b5fb4"}


def _colour(channel: str, place: int) -> str:
    return _COLOURS.get(channel, f"C{place}")


def _panels(titles: list[str]) -> tuple[Figure, Any]:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(titles), figsize=(max(5.0, 4.0 * len(titles)), 3.4), sharey=True, squeeze=False, layout="constrained"
    )
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("x / mm")
        axis.grid(alpha=0.25)
    axes[0][0].set_ylabel("radiance factor")
    # Notebooks show what a cell returns, and would show an open figure a second time.
    plt.close(figure)
    return figure, axes[0]


def profile(shown: Profile) -> Figure:
    m = shown.medium
    title = f"σ_t {m.sigma_t_per_mm:g} /mm, α {m.albedo:g}, g {m.g:g}, {shown.thickness_mm:g} mm"
    figure, (axis,) = _panels([title])
    for place, (channel, values) in enumerate(shown.channels.items()):
        colour = _colour(channel, place)
        axis.plot(shown.x_mm, values, color=colour, label=channel, linewidth=1.2)
        if channel in shown.std_errors:
            error = 2 * shown.std_errors[channel]
            axis.fill_between(shown.x_mm, values - error, values + error, color=colour, alpha=0.2, linewidth=0)
    axis.legend(frameon=False)
    return figure


def measurement(shown: Measurement) -> Figure:
    thicknesses = shown.thicknesses_mm
    figure, axes = _panels([f"{shown.material}, {t:g} mm" for t in thicknesses])
    for place, channel in enumerate(shown.channels):
        for one in shown.profiles:
            if one.channel == channel:
                axis = axes[thicknesses.index(one.thickness_mm)]
                axis.plot(one.x_mm, one.values, color=_colour(channel, place), label=channel, linewidth=1.0)
    axes[-1].legend(frameon=False)
    return figure


def fits(shown: MaterialFit) -> Figure:
    thicknesses = sorted({curves.thickness_mm for fit in shown.channels for curves in fit.curves})
    if not thicknesses:
        raise ValueError("there are no curves to draw: ask for the fit with curves=True")
    figure, axes = _panels([f"{shown.material}, {t:g} mm" for t in thicknesses])
    for place, fit in enumerate(shown.channels):
        colour = _colour(fit.channel, place)
        for curves in fit.curves:
            axis = axes[thicknesses.index(curves.thickness_mm)]
            axis.plot(curves.x_mm, curves.measured, ".", color=colour, markersize=2.5, alpha=0.5)
            best = curves.refined if curves.refined is not None else curves.best_record
            axis.plot(curves.x_mm, best, color=colour, label=f"{fit.channel} fit", linewidth=1.2)
    axes[-1].legend(frameon=False)
    return figure


def scale(shown: ScaleCurve) -> Figure:
    figure, (axis,) = _panels(["aggregate error by the scale factor (Eq. 3)"])
    axis.plot(shown.mu, shown.error, color="black", linewidth=1.2)
    axis.axvline(shown.best_mu, color="#c0392b", linewidth=0.8, label=f"μ = {shown.best_mu:.3f}")
    axis.set_xlabel("μ")
    axis.set_ylabel("error")
    axis.legend(frameon=False)
    return figure


def distance_map(shown: DistanceMap) -> Figure:
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    columns = min(4, len(shown.g))
    rows = -(-len(shown.g) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(3 * columns, 2.6 * rows), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    plt.close(figure)
    norm = LogNorm(shown.errors.min(), min(shown.errors.max(), 100 * shown.errors.min()))
    for axis in axes.flat[len(shown.g) :]:
        axis.set_visible(False)
    # A dictionary may hold an albedo of 1, which has no logarithm.
    missing = np.maximum(1 - shown.albedo, 1e-6)
    for axis, g, errors, best, similar in zip(
        axes.flat, shown.g, shown.errors, shown.best, shown.similar, strict=False
    ):
        mesh = axis.pcolormesh(missing, shown.sigma_t_per_mm, errors, norm=norm, cmap="viridis_r", shading="nearest")
        axis.plot(max(1 - best.albedo, 1e-6), best.sigma_t_per_mm, "x", color="#c0392b")
        if similar is not None:
            axis.plot(max(1 - similar.albedo, 1e-6), similar.sigma_t_per_mm, "o", mfc="none", color="white")
        axis.set(xscale="log", yscale="log", title=f"{shown.channel}, g = {g:g}")
        axis.set_ylim(shown.sigma_t_per_mm[0], shown.sigma_t_per_mm[-1])
    for axis in axes[-1]:
        axis.set_xlabel("1 − α")
    for axis in axes[:, 0]:
        axis.set_ylabel("σ_t / (1/mm)")
    figure.colorbar(mesh, ax=axes, label="distance", shrink=0.8)
    return figure
