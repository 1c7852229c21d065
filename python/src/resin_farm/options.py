"""Options of fits, with the names and defaults of `farmctl`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal, TypeAlias

from resin_farm._wire import fits_pb2, model_pb2
from resin_farm._wire.set_up import LABELLED, SetUp
from resin_farm.measurement import Measurement

Range: TypeAlias = float | tuple[float | None, float | None]
"""A value, which holds a parameter, or (lowest, highest), None where it is free."""


class FitOptions(SetUp, total=False):
    """Options of a fit, those of the set-up included. One that is left out has the default of `farmctl fit`."""

    sigma_t_per_mm: Range
    """The extinction coefficient, in 1/mm."""
    albedo: Range
    """The single-scattering albedo."""
    g: Range
    """The anisotropy, the mean cosine of the phase function."""
    mu: float
    """Factor on the measured values."""
    mu_std_error: float
    """Its standard error."""
    objective: Literal["paper", "likelihood"]
    """The minimised objective, the likelihood if it is not set."""
    phase: Literal["two_lobes", "per_channel", "henyey_greenstein"]
    """The phase function p = (1 − b) HG(g₁) + b HG(g₂), if the weight b is uncertain in the dictionary's scene. Two
    lobes, with b as the scene has it, if it is not set: the channels of a material share one b unless the scene has
    another scope. "per_channel": each channel has its own b. "henyey_greenstein": b = 0. The paper's objective allows
    two lobes only."""
    lambda_: float
    """Weight of the gradients in the paper's distance."""
    wavelet: Literal["spline", "haar"]
    """The wavelet of the gradients in the paper's distance."""
    level: int
    """Its level: gradients are smoothed over about 2^level pixels."""
    top: int
    """Number of records to return for each channel."""
    curves: bool
    """Return the compared profiles, to plot them."""


_OBJECTIVES = {"paper": fits_pb2.OBJECTIVE_PAPER, "likelihood": fits_pb2.OBJECTIVE_LIKELIHOOD}
_PHASES = {
    "two_lobes": fits_pb2.PHASE_MODEL_UNSPECIFIED,
    "per_channel": fits_pb2.PHASE_MODEL_PER_CHANNEL,
    "henyey_greenstein": fits_pb2.PHASE_MODEL_HENYEY_GREENSTEIN,
}
_WAVELETS = {"spline": fits_pb2.WAVELET_QUADRATIC_SPLINE, "haar": fits_pb2.WAVELET_HAAR}


def wire(given: Mapping[str, Any], *, refine: bool) -> fits_pb2.FitOptions:
    """The options as a message.

    Raises:
        TypeError: if there is no such option.
        ValueError: if a name is not one of those that are allowed.
    """
    if unknown := set(given) - set(FitOptions.__annotations__):
        raise TypeError(f"{', '.join(sorted(unknown))}: options are {', '.join(FitOptions.__annotations__)}")
    fields: dict[str, Any] = {"refine": refine}
    for name, value in given.items():
        match name:
            case "sigma_t_per_mm" | "albedo" | "g":
                fields[name] = _bounds(value)
            case "objective":
                fields[name] = _one_of(name, value, _OBJECTIVES)
            case "phase":
                fields[name] = _one_of(name, value, _PHASES)
            case "wavelet":
                fields[name] = _one_of(name, value, _WAVELETS)
            case "lambda_":
                fields["lambda"] = value
            case _:
                fields[name] = value
    return fits_pb2.FitOptions(**fields)


def flags(given: Mapping[str, Any]) -> list[str]:
    """The options as arguments of `farmctl measure`.

    Raises:
        TypeError: if it has no such option.
    """
    known = set(FitOptions.__annotations__) - {"top", "curves"}
    if unknown := set(given) - known:
        raise TypeError(f"{', '.join(sorted(unknown))}: options with an output are {', '.join(sorted(known))}")
    return [f"--{_FLAGS.get(name, name.replace('_', '-'))}={_flag_value(value)}" for name, value in given.items()]


_FLAGS = {"sigma_t_per_mm": "sigma-t", "lambda_": "lambda"}


def _flag_value(value: object) -> str:
    if isinstance(value, tuple):
        return "..".join("" if end is None else str(end) for end in value)
    return "hg" if value == "henyey_greenstein" else str(value).replace("_", "-")


_OF_PROFILES = {f.name for f in model_pb2.MeasuredProfile.DESCRIPTOR.fields}


def assumed(given: Mapping[str, Any], materials: Iterable[Measurement]) -> tuple[str, ...]:
    """The options about the set-up that have their defaults, for at least one profile."""
    profiles = [profile for material in materials for profile in material.profiles]

    def is_assumed(name: str) -> bool:
        of_profiles = name in _OF_PROFILES and all(name in profile.set_up for profile in profiles)
        return name not in given and not of_profiles

    return tuple(name for name in LABELLED if is_assumed(name))


def _bounds(given: Range) -> fits_pb2.Bounds:
    low, high = given if isinstance(given, tuple) else (given, given)
    return fits_pb2.Bounds(min=low, max=high)


def _one_of(name: str, value: str, allowed: Mapping[str, int]) -> int:
    if value not in allowed:
        raise ValueError(f"{name} = {value!r}: allowed are {', '.join(allowed)}")
    return allowed[value]
