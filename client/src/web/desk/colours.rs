//! Computes the colours of thick slabs, as an impression of materials.

use anyhow::Result;
use farm_proto::wire;
use optics_layers::{Print, PrintLayer};
use optics_model::phase::PhaseShape;
use optics_model::scene::Scene;
use optics_model::{Invalid, Medium};
use rayon::prelude::*;

/// Largest number of media in one question.
const MOST: usize = 256;
const THICK_MM: f64 = 20.0;
const IOR: f64 = 1.5;

/// Radiance factors of slabs half over black and half over white: the mean over the edge.
pub(super) fn radiance_factors(media: Vec<wire::Medium>) -> Result<Vec<f64>> {
    if media.len() > MOST {
        return Err(Invalid::new("media", media.len(), format!("at most {MOST} are allowed")).into());
    }
    let media = media.into_iter().map(Medium::try_from).collect::<Result<Vec<_>, _>>()?;
    media.into_par_iter().map(radiance_factor).collect()
}

fn radiance_factor(medium: Medium) -> Result<f64> {
    let phase = PhaseShape::default();
    // Narrower peaks take long, and hardly change an impression.
    let peak = phase.function(medium.g())?.peak_width().max(1.0 - Print::MOST_G);
    let slab = PrintLayer { medium, phase, thickness_mm: THICK_MM };
    let factors = Print::new(&Scene::smooth(), IOR, peak).radiance_factors(&[slab], &[0.0, 1.0]);
    Ok(f64::midpoint(factors[0], factors[1]))
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
