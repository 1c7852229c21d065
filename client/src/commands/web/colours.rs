//! Computes the colours of thick slabs, as an impression of materials.

use std::collections::BTreeMap;

use anyhow::Result;
use optics_layers::{Print, PrintLayer};
use optics_model::Medium;
use optics_model::fit::MaterialFit;
use optics_model::phase::PhaseShape;
use optics_model::scene::Scene;
use rayon::prelude::*;

/// Largest number of materials with a colour.
const MOST: usize = 80;
const THICK_MM: f64 = 20.0;
const IOR: f64 = 1.5;

/// Radiance factors in red, green and blue, by material, of those that were measured in R, G and B.
pub(super) fn colours(fits: &[MaterialFit]) -> Result<BTreeMap<String, [f64; 3]>> {
    let with_media = fits.iter().filter_map(|fit| Some((fit.material.clone(), rgb(fit)?)));
    let with_media: Vec<_> = with_media.take(MOST).collect();
    let colour = |(name, [r, g, b]): (String, [Medium; 3])| {
        Ok((name, [radiance_factor(r)?, radiance_factor(g)?, radiance_factor(b)?]))
    };
    with_media.into_par_iter().map(colour).collect()
}

fn rgb(fit: &MaterialFit) -> Option<[Medium; 3]> {
    let medium = |name: &str| {
        let channel = fit.channels.iter().find(|channel| channel.channel == name)?;
        Some(channel.refined.as_ref()?.best.medium)
    };
    Some([medium("R")?, medium("G")?, medium("B")?])
}

/// Radiance factor of a slab half over black and half over white: the mean over the edge.
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

    /// Media that scatter more look brighter.
    #[test]
    fn colours_follow_the_albedo() {
        let factor = |sigma_t_per_mm, albedo| {
            radiance_factor(Medium::new(sigma_t_per_mm, albedo, 0.4).unwrap()).unwrap()
        };
        let factors = [factor(20.0, 0.9999), factor(6.0, 0.99), factor(6.0, 0.7), factor(20.0, 0.05)];
        assert!(factors.windows(2).all(|pair| pair[0] > pair[1]), "{factors:?}");
        assert!(factors[0] > 0.8 && factors[0] < 1.1 && factors[3] < 0.1, "{factors:?}");
    }
}
