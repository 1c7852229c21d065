//! Converts the search of the scale factor, and distance maps.

use super::mirror::{list, mirror, optional, required};
use crate::wire;
use optics_model::fit::{Common, DistanceMap, GError, MapLayer, MuRange, ScaleCurve, ScalePoint};
use optics_model::invalid::{Invalid, Result, each};
use optics_model::medium::Medium;

impl TryFrom<wire::MuRange> for MuRange {
    type Error = Invalid;

    fn try_from(range: wire::MuRange) -> Result<Self> {
        let (min, max, step) = Self::default().parts();
        Self::new(range.min.unwrap_or(min), range.max.unwrap_or(max), range.step.unwrap_or(step))
    }
}

impl From<MuRange> for wire::MuRange {
    fn from(range: MuRange) -> Self {
        let (min, max, step) = range.parts();
        Self { min: Some(min), max: Some(max), step: Some(step) }
    }
}

mirror!(ScalePoint { mu, error });

impl From<GError> for wire::GError {
    fn from(e: GError) -> Self {
        let best = wire::ScalePoint { mu: e.best_mu, error: e.best_mu_error };
        Self { g: e.g, error: e.error, best: Some(best) }
    }
}

impl TryFrom<wire::GError> for GError {
    type Error = Invalid;

    fn try_from(e: wire::GError) -> Result<Self> {
        let best = required("best", e.best)?;
        Ok(Self { g: e.g, error: e.error, best_mu: best.mu, best_mu_error: best.error })
    }
}

mirror!(Common {
    mu,
    mu_std_error,
    mu_interval: required,
    mu_chosen,
    g,
    g_spread,
    g_equal_probability,
    g_change,
    g_interval: optional,
    by_g: list
});
mirror!(ScaleCurve { points: list, best: required, std_error, curvature, at_end, by_g: list, best_g });

impl From<DistanceMap> for wire::DistanceMap {
    fn from(map: DistanceMap) -> Self {
        let layer = |layer: MapLayer| wire::MapLayer {
            g: layer.g,
            errors: layer.errors.concat(),
            best: Some(layer.best.into()),
            similar: layer.similar.map(Into::into),
        };
        Self {
            channel: map.channel,
            sigma_t_per_mm: map.sigma_t_per_mm,
            albedo: map.albedo,
            sample_ior: map.sample_ior,
            best_layer: map.best_layer as u32,
            layers: map.layers.into_iter().map(layer).collect(),
        }
    }
}

impl TryFrom<wire::DistanceMap> for DistanceMap {
    type Error = Invalid;

    fn try_from(map: wire::DistanceMap) -> Result<Self> {
        let albedos = map.albedo.len().max(1);
        let layers = each("layers", map.layers, |layer| {
            Ok(MapLayer {
                g: layer.g,
                errors: layer.errors.chunks(albedos).map(<[f64]>::to_vec).collect(),
                best: required("best", layer.best)?.try_into()?,
                similar: layer.similar.map(Medium::try_from).transpose()?,
            })
        })?;
        Ok(Self {
            channel: map.channel,
            sigma_t_per_mm: map.sigma_t_per_mm,
            albedo: map.albedo,
            sample_ior: map.sample_ior,
            best_layer: map.best_layer as usize,
            layers,
        })
    }
}
