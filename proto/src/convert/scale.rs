//! The search of the scale factor, and distance maps.

use super::required;
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

impl From<ScalePoint> for wire::ScalePoint {
    fn from(point: ScalePoint) -> Self {
        Self { mu: point.mu, error: point.error }
    }
}

impl From<wire::ScalePoint> for ScalePoint {
    fn from(point: wire::ScalePoint) -> Self {
        Self { mu: point.mu, error: point.error }
    }
}

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

impl From<Common> for wire::Common {
    fn from(common: Common) -> Self {
        Self {
            mu: common.mu,
            mu_std_error: common.mu_std_error,
            mu_interval: Some(common.mu_interval.into()),
            mu_chosen: common.mu_chosen,
            g: common.g,
            g_interval: common.g_interval.map(Into::into),
            by_g: common.by_g.into_iter().map(Into::into).collect(),
        }
    }
}

impl TryFrom<wire::Common> for Common {
    type Error = Invalid;

    fn try_from(common: wire::Common) -> Result<Self> {
        Ok(Self {
            mu: common.mu,
            mu_std_error: common.mu_std_error,
            mu_interval: required("mu_interval", common.mu_interval)?.into(),
            mu_chosen: common.mu_chosen,
            g: common.g,
            g_interval: common.g_interval.map(Into::into),
            by_g: each("by_g", common.by_g, TryInto::try_into)?,
        })
    }
}

impl From<ScaleCurve> for wire::ScaleCurve {
    fn from(curve: ScaleCurve) -> Self {
        Self {
            points: curve.points.into_iter().map(Into::into).collect(),
            best: Some(curve.best.into()),
            std_error: curve.std_error,
            curvature: curve.curvature,
            at_end: curve.at_end,
            by_g: curve.by_g.into_iter().map(Into::into).collect(),
            best_g: curve.best_g,
        }
    }
}

impl TryFrom<wire::ScaleCurve> for ScaleCurve {
    type Error = Invalid;

    fn try_from(curve: wire::ScaleCurve) -> Result<Self> {
        Ok(Self {
            points: curve.points.into_iter().map(Into::into).collect(),
            best: required("best", curve.best)?.into(),
            std_error: curve.std_error,
            curvature: curve.curvature,
            at_end: curve.at_end,
            by_g: each("by_g", curve.by_g, TryInto::try_into)?,
            best_g: curve.best_g,
        })
    }
}

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
