"""Writes remarks on an answer that affect how it may be used, worded as in farmctl."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from resin_farm import _display
from resin_farm.channel_fit import ChannelFit
from resin_farm.medium import Interval

# Probability below which noise and the priors of the set-up do not explain a measurement; the same as in farmctl.
_UNLIKELY = 1e-3


def of_assumed(names: Sequence[str], channels: Iterable[ChannelFit]) -> list[str]:
    """The assumptions about the set-up; records alone need none."""
    is_refined = any(fit.refined is not None for fit in channels)
    return [f"assumed: {', '.join(names)}"] if names and is_refined else []


def of_channel(material: str, fit: ChannelFit) -> Iterator[str]:
    name = f"{material} {fit.channel}"
    refined = fit.refined
    if fit.outside is not None:
        yield f"{name}: outside the dictionary, {fit.outside} than every record: check levels, or compute a wider one"
    if refined is None:
        return
    cause = f"; the most likely cause: {refined.suspicion}" if refined.suspicion else ""
    likelihood = refined.likelihood
    chi2 = f"χ² {likelihood.chi2:.0f} of {likelihood.degrees_of_freedom:.0f}"
    if likelihood.probability < _UNLIKELY:
        yield (
            f"{name}: {chi2}, p < {_UNLIKELY}: noise and the priors of the set-up do not explain the data; the "
            f"intervals were widened and may still be wrong{cause}"
        )
    elif refined.suspicion:
        yield (
            f"{name}: {chi2}, but the measurements contradict the set-up as given: the intervals are not to "
            f"be trusted{cause}"
        )
    elif likelihood.degrees_of_freedom >= 100 and likelihood.chi2 < 0.5 * likelihood.degrees_of_freedom:
        yield f"{name}: {chi2} is too small: neighbouring pixels share their errors, or the errors are too large"
    if likelihood.outliers:
        yield f"{name}: {likelihood.outliers} of its pixels left out"
    if not refined.converged:
        yield f"{name}: not converged: neither the medium nor its intervals hold"
    elif not refined.resolved_at_g and fit.outside is None:
        yield f"{name}: unresolved: {_unresolved(refined.sigma_t_per_mm)}"
    elif not refined.resolved and fit.outside is None:
        yield f"{name}: g open: σ_t and α are valid for this g only"
    if refined.valley:
        yield f"{name}: σ_t and g trade off, trust σ_s(1−g) and σ_a"


def _unresolved(sigma_t: Interval) -> str:
    """The reason: the data, or a dictionary that ends before the interval of σ_t does."""
    if sigma_t.high > 2 * sigma_t.low or sigma_t.open_low == sigma_t.open_high:
        return "the data do not determine the medium"
    side, end = ("above", sigma_t.high) if sigma_t.open_high else ("below", sigma_t.low)
    return (
        f"σ_t may lie {side} {_display.number(end)} /mm, where the dictionary or sigma_t_per_mm ends; compute a wider "
        "dictionary, or give g"
    )
