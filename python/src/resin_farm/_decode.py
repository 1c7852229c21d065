"""Decodes the answers of fits, from messages or, for functions that only farmctl has, from its JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from resin_farm._wire import fits_pb2, model_pb2
from resin_farm.channel_fit import (
    Candidate,
    ChannelFit,
    Curves,
    Likelihood,
    NuisanceEstimate,
    Refined,
    SceneEstimate,
    SourceShare,
)
from resin_farm.medium import Array, Interval, Medium, SecondLobe
from resin_farm.results import MaterialFit, Measured, ScaleCurve


def material_fit(wire: fits_pb2.MaterialFit, assumed: tuple[str, ...] = ()) -> MaterialFit:
    return MaterialFit(wire.material, tuple(map(_channel_fit, wire.channels)), assumed)


def measured(wire: fits_pb2.MeasureResponse, dictionary: str, assumed: tuple[str, ...]) -> Measured:
    common = wire.common
    return Measured(
        materials=tuple(material_fit(material, assumed) for material in wire.materials),
        mu=common.mu,
        mu_std_error=common.mu_std_error,
        mu_chosen=common.mu_chosen,
        g=common.g if common.HasField("g") else None,
        g_interval=Interval._of_wire(common.g_interval) if common.HasField("g_interval") else None,
        dictionary=dictionary,
        scale=_scale(wire.scale) if wire.HasField("scale") else None,
        assumed=assumed,
    )


def _scale(wire: fits_pb2.ScaleCurve) -> ScaleCurve:
    return ScaleCurve(
        mu=np.array([point.mu for point in wire.points]),
        error=np.array([point.error for point in wire.points]),
        best_mu=wire.best.mu,
        std_error=wire.std_error if wire.HasField("std_error") else None,
        best_g=wire.best_g,
    )


def _channel_fit(wire: fits_pb2.ChannelFit) -> ChannelFit:
    outside = {fits_pb2.OUTSIDE_BRIGHTER: "brighter", fits_pb2.OUTSIDE_DARKER: "darker"}.get(wire.outside)
    refined = _refined(wire.refined) if wire.HasField("refined") else None
    return ChannelFit(
        channel=wire.channel,
        candidates=tuple(map(_candidate, wire.candidates)),
        refined=refined,
        outside=outside,
        curves=tuple(_curves(curves) for curves in wire.curves),
    )


def _candidate(wire: fits_pb2.Candidate) -> Candidate:
    records = tuple(t.record if t.HasField("record") else None for t in wire.thicknesses)
    return Candidate(Medium._of_wire(wire.medium), wire.sample_ior, wire.error, records)


def _curves(wire: fits_pb2.FitCurves) -> Curves:
    refined = np.array(wire.refined.values) if wire.HasField("refined") else None
    best = np.array(wire.candidates[0].values)
    residuals = np.array(wire.residuals) if wire.residuals else None
    left_out = np.array(wire.left_out, dtype=int)
    measured = np.array(wire.measured.values)
    return Curves(wire.thickness_mm, np.array(wire.x_mm), measured, best, refined, residuals, left_out)


# Names in JSON that differ from those of the messages.
_CAUSES = {
    "unspecified": "unknown",
    "edge_offset": "edge_offset_mm",
    "blur": "blur_mm",
    "thickness": "thickness_mm",
}


def _refined(wire: fits_pb2.Refined) -> Refined:
    suspicion = None
    if wire.HasField("suspicion"):
        cause = fits_pb2.Cause.Name(wire.suspicion.cause).removeprefix("CAUSE_").lower()
        suspicion = _CAUSES.get(cause, cause)
    return Refined(
        medium=Medium._of_wire(wire.best.medium),
        sigma_t_per_mm=Interval._of_wire(wire.sigma_t_per_mm),
        albedo=Interval._of_wire(wire.albedo),
        g=Interval._of_wire(wire.g),
        reduced_scattering_per_mm=Interval._of_wire(wire.reduced_scattering_per_mm),
        absorption_per_mm=Interval._of_wire(wire.absorption_per_mm),
        resolved=wire.resolved,
        # Older coordinators send one flag only.
        resolved_at_g=wire.resolved_at_g or wire.resolved,
        valley=wire.valley,
        misfit=wire.misfit,
        error=wire.best.error,
        covariance=np.array(wire.covariance).reshape(3, 3),
        suspicion=suspicion,
        likelihood=_likelihood(wire.likelihood),
        second_lobe=SecondLobe._of_wire(wire.second_lobe) if wire.HasField("second_lobe") else None,
        converged=wire.descent in {fits_pb2.DESCENT_END_UNSPECIFIED, fits_pb2.DESCENT_END_AT_BOUND},
    )


_NUISANCES = {
    fits_pb2.NUISANCE_SCALE: "scale",
    fits_pb2.NUISANCE_BLUR_VARIANCE: "blur_variance_mm2",
    fits_pb2.NUISANCE_THICKNESS: "thickness_mm",
    fits_pb2.NUISANCE_ORIGIN: "origin_mm",
    fits_pb2.NUISANCE_GAIN: "gain",
    fits_pb2.NUISANCE_ZERO: "zero",
    fits_pb2.NUISANCE_SLOPE: "slope",
    fits_pb2.NUISANCE_WEDGE: "wedge",
}


def _likelihood(wire: fits_pb2.Likelihood) -> Likelihood:
    def nuisance(n: fits_pb2.NuisanceEstimate) -> NuisanceEstimate:
        profile = n.profile_mm if n.HasField("profile_mm") else None
        prior = n.prior_std_error if np.isfinite(n.prior_std_error) else None
        return NuisanceEstimate(_NUISANCES.get(n.nuisance, "unknown"), profile, n.value, n.std_error, n.prior, prior)

    def share(s: fits_pb2.SourceShare) -> SourceShare:
        source = fits_pb2.ErrorSource.Name(s.source).removeprefix("ERROR_SOURCE_").lower()
        quantity = s.quantity if s.HasField("quantity") else None
        return SourceShare(source, s.sigma_t, s.albedo, s.reduced_scattering, s.absorption, quantity)

    def scene(e: fits_pb2.SceneEstimate) -> SceneEstimate:
        scope = model_pb2.Scope.Name(e.scope).removeprefix("SCOPE_").lower()
        slab = e.slab_mm if e.HasField("slab_mm") else None
        errors = (e.std_error, e.prior, e.prior_std_error, e.at_end)
        return SceneEstimate(e.quantity, e.unit, scope, slab, e.value, *errors)

    return Likelihood(
        wire.chi2,
        wire.degrees_of_freedom,
        wire.probability,
        tuple(map(nuisance, wire.nuisances)),
        len(wire.outliers),
        tuple(map(share, wire.budget)),
        tuple(map(scene, wire.scene)),
    )


# From farmctl's JSON, for functions that only farmctl has.


def measured_of_json(found: Mapping[str, Any]) -> Measured:
    common = found["common"]
    g_interval = common["g_interval"]
    return Measured(
        materials=tuple(material_of_json(material, found["assumed"]) for material in found["materials"]),
        mu=common["mu"],
        mu_std_error=common["mu_std_error"],
        mu_chosen=common["mu_chosen"],
        g=common["g"],
        g_interval=Interval._of_json(g_interval) if g_interval else None,
        dictionary=found["dictionary"],
        scale=_scale_of_json(found["scale"]) if found["scale"] else None,
        assumed=tuple(found["assumed"]),
    )


def _scale_of_json(found: Mapping[str, Any]) -> ScaleCurve:
    return ScaleCurve(
        mu=np.array([point["mu"] for point in found["curve"]]),
        error=np.array([point["error"] for point in found["curve"]]),
        best_mu=found["mu"],
        std_error=found["std_error"],
        best_g=found["best_g"],
    )


def material_of_json(found: Mapping[str, Any], assumed: Iterable[str] = ()) -> MaterialFit:
    return MaterialFit(found["material"], tuple(map(_channel_of_json, found["channels"])), tuple(assumed))


def _medium_of_json(found: Mapping[str, Any]) -> Medium:
    return Medium(found["sigma_t_per_mm"], found["albedo"], found["g"])


def _channel_of_json(found: Mapping[str, Any]) -> ChannelFit:
    def candidate(c: Mapping[str, Any]) -> Candidate:
        records = tuple(t.get("record") for t in c["thicknesses"])
        return Candidate(_medium_of_json(c), c["sample_ior"], c["error"], records)

    refined = found["refined"]
    return ChannelFit(
        channel=found["channel"],
        candidates=tuple(map(candidate, found["candidates"])),
        refined=_refined_of_json(refined) if refined else None,
        outside=found["outside"],
        curves=tuple(_curves_of_json(curves) for curves in found.get("curves", [])),
    )


def _curves_of_json(found: Mapping[str, Any]) -> Curves:
    def values(curve: Mapping[str, Any]) -> Array:
        return np.array(curve["values"])

    refined = values(found["refined"]) if found.get("refined") else None
    best, measured = values(found["candidates"][0]), values(found["measured"])
    residuals = np.array(found["residuals"]) if found.get("residuals") else None
    left_out = np.array(found.get("left_out", []), dtype=int)
    return Curves(found["thickness_mm"], np.array(found["x_mm"]), measured, best, refined, residuals, left_out)


def _refined_of_json(found: Mapping[str, Any]) -> Refined:
    def interval(name: str) -> Interval:
        return Interval._of_json(found[f"{name}_interval"])

    suspicion, second_lobe = found["suspicion"], found.get("second_lobe")
    return Refined(
        medium=_medium_of_json(found),
        sigma_t_per_mm=interval("sigma_t"),
        albedo=interval("albedo"),
        g=interval("g"),
        reduced_scattering_per_mm=interval("reduced_scattering"),
        absorption_per_mm=interval("absorption"),
        resolved=found["resolved"],
        resolved_at_g=found["resolved_at_g"],
        valley=found["valley"],
        misfit=found["misfit"],
        error=found["error"],
        covariance=np.array(found["covariance"]),
        suspicion=suspicion["cause"] if suspicion else None,
        likelihood=_likelihood_of_json(found["likelihood"]),
        second_lobe=SecondLobe._of_json(second_lobe) if second_lobe else None,
        converged=found.get("descent", "at_bound") == "at_bound",
    )


def _likelihood_of_json(found: Mapping[str, Any]) -> Likelihood:
    def nuisance(n: Mapping[str, Any]) -> NuisanceEstimate:
        return NuisanceEstimate(
            n["nuisance"], n["profile_mm"], n["value"], n["std_error"], n["prior"], n["prior_std_error"]
        )

    return Likelihood(
        found["chi2"],
        found["degrees_of_freedom"],
        found["probability"],
        tuple(map(nuisance, found["nuisances"])),
        len(found["outliers"]),
        tuple(SourceShare(**share) for share in found.get("budget", ())),
        tuple(SceneEstimate(**estimate) for estimate in found.get("scene", ())),
    )
