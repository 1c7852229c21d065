"""Pictures, by matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from resin_farm.measurement import Measurement
    from resin_farm.profile import Profile
    from resin_farm.results import MaterialFit

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
