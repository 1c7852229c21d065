//! Computes the colours of thick slabs, as an impression of materials.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use farm_proto::wire;
use optics_model::job::JobSpec;
use optics_model::scene::{Channel, Scene};
use optics_model::{Invalid, Medium, TransportPoint, Walks};
use optics_tracer::trace;
use rayon::prelude::*;

/// Largest number of media in one question.
const MOST: usize = 256;
/// Thickness of the slab in mm; thinner where its optical thickness would be too large to trace.
const THICK_MM: f64 = 20.0;
const OPTICALLY_THICK: f64 = 400.0;
const WALKS: u64 = 2000;
const IOR: f64 = 1.5;

/// Radiance factors of slabs half over black and half over white: the mean over the edge.
pub(super) fn radiance_factors(media: Vec<wire::Medium>) -> Result<Vec<f64>> {
    if media.len() > MOST {
        return Err(Invalid::new("media", media.len(), format!("at most {MOST} are allowed")).into());
    }
    let media = media.into_iter().map(Medium::try_from).collect::<Result<Vec<_>, _>>()?;
    media.par_iter().map(radiance_factor).collect()
}

fn radiance_factor(medium: &Medium) -> Result<f64> {
    let scene = Scene::paper().with_channels(vec![Channel::new("mono", 1.0, 0.0)?])?;
    let thickness_mm = THICK_MM.min(OPTICALLY_THICK / medium.sigma_t_per_mm());
    let point = TransportPoint::new(medium.sigma_t_per_mm(), medium.g(), thickness_mm, IOR)?;
    let job = JobSpec::new(scene, point, vec![medium.albedo()], Walks::new(WALKS)?, 1, false)?;
    let records = trace(&job, &AtomicBool::new(false))?;
    let values = records[0].profiles[0].radiance_factor.values();
    Ok(values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn medium(sigma_t_per_mm: f64, albedo: f64) -> wire::Medium {
        Medium::new(sigma_t_per_mm, albedo, 0.4).unwrap().into()
    }

    /// Media that scatter more look brighter.
    #[test]
    fn colours_follow_the_albedo() {
        let media = vec![medium(20.0, 0.9999), medium(6.0, 0.99), medium(6.0, 0.7), medium(20.0, 0.05)];
        let factors = radiance_factors(media).unwrap();
        assert!(factors.windows(2).all(|pair| pair[0] > pair[1]), "{factors:?}");
        assert!(factors[0] > 0.8 && factors[0] < 1.1 && factors[3] < 0.1, "{factors:?}");
        let error = radiance_factors(vec![medium(1.0, 0.5); MOST + 1]).unwrap_err();
        assert!(error.to_string().contains("at most 256"), "{error}");
    }
}
