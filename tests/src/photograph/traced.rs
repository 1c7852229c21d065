//! Traces edges under slabs of media.
use optics_model::job::JobSpec;
use optics_model::scene::Sensor;
use optics_model::{Medium, Scene, TransportPoint, Walks};
use rayon::prelude::*;

use super::subject::Edge;
use crate::stored;

/// Pixels of the traced profiles, of 2.3 µm: a linear course between the centres of pixels four times as wide would add
/// 0.6 % to the variance of a lens of 36 µm, more than the error that sessions state for it.
const WIDTH_MM: f64 = 12.0;
const PIXELS: u32 = 5184;

const SAMPLE_IOR: f64 = 1.53;

/// The edge of a scene's board under a slab with one medium per channel.
///
/// # Panics
/// If the scene has other than three channels, or there is no such slab.
#[must_use]
pub fn traced(scene: &Scene, media: [Medium; 3], thickness_mm: f64, walks: u64, seed: u64) -> Edge {
    let profile = |c: usize| profile(scene, c, &media[c], thickness_mm, walks, seed);
    let profiles: Vec<Vec<f64>> = (0..3).into_par_iter().map(profile).collect();
    Edge::new(move |c, x_mm| at(&profiles[c], x_mm))
}

/// The edge of a scene's board, of one channel, under a slab.
///
/// # Panics
/// If there is no such slab.
#[must_use]
pub fn traced_channel(scene: &Scene, medium: &Medium, thickness_mm: f64, walks: u64, seed: u64) -> Edge {
    let profile = profile(scene, 0, medium, thickness_mm, walks, seed);
    Edge::new(move |_, x_mm| at(&profile, x_mm))
}

fn profile(scene: &Scene, c: usize, medium: &Medium, thickness_mm: f64, walks: u64, seed: u64) -> Vec<f64> {
    let build = || {
        let scene = scene.clone().with_channels(vec![scene.channels()[c].clone()])?;
        let scene = scene.with_sensor(Sensor::new(WIDTH_MM, PIXELS, 0.0)?);
        let point = TransportPoint::new(medium.sigma_t_per_mm(), medium.g(), thickness_mm, SAMPLE_IOR)?;
        JobSpec::new(scene, point, vec![medium.albedo()], Walks::new(walks)?, seed, false)
    };
    let job = build().expect("the slab is valid");
    stored::records(&job).radiance_factors(0, 0).map(f64::from).collect()
}

/// Linear between the centres of the pixels of one side, constant beyond them: the board's own edge is a jump.
fn at(values: &[f64], x_mm: f64) -> f64 {
    let half = values.len() / 2;
    let (from, to) = if x_mm < 0.0 { (0, half - 1) } else { (half, values.len() - 1) };
    let place = (x_mm / WIDTH_MM + 0.5) * values.len() as f64 - 0.5;
    let place = place.clamp(from as f64, to as f64);
    let (i, share) = (place as usize, place.fract());
    let next = values[(i + 1).min(to)];
    values[i] + share * (next - values[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A profile is linear on each side and jumps at the edge.
    #[test]
    fn profile_jumps_at_the_edge() {
        let values: Vec<f64> =
            (0..12).map(|i| if i < 6 { f64::from(i) } else { 10.0 + f64::from(i) }).collect();
        // Pixels of 1 mm: centres at −5.5 … 5.5.
        let exact = [(-5.5, 0.0), (-4.75, 0.75), (-1e-9, 5.0), (1e-9, 16.0), (-9.0, 0.0), (9.0, 21.0)];
        for (x, value) in exact {
            assert!((at(&values, x) - value).abs() < 1e-12, "{x}: {}", at(&values, x));
        }
    }
}
