//! Directions of walks after a scattering.

use glam::Vec3;
use optics_model::phase::PhaseSampler;

use super::math::unit_vector;
use super::rng::symmetric;

/// Direction after scattering of the unit vector `direction`; 16 bits of `bits` make the polar angle, 16 the azimuth.
#[inline]
pub fn scatter(phase: &PhaseSampler, direction: Vec3, bits: u32) -> Vec3 {
    let cos = phase.cosine(symmetric(bits));
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let (x, y) = unit_vector(bits);
    rotate(direction, sin * x, sin * y, cos)
}

/// The vector with coordinates (x, y, z) in a frame whose third axis is the unit vector `n`.
///
/// Half a turn about u = n ± e_z carries ±e_z to n and needs no frame: v = u (u·l)/(1 + |n_z|) − l with
/// l = (x, y, ±z), the sign being that of n_z. If |n|² = 1 + ε, then |v|² = 1 + ε k² with k the bracket below,
/// and k² has mean at most 1 over the azimuth: rounding does not pile up, and no normalisation is needed.
fn rotate(n: Vec3, x: f32, y: f32, z: f32) -> Vec3 {
    let q = (n.x * x + n.y * y) / (1.0 + n.z.abs());
    let k = q + z;
    Vec3::new(n.x * k - x, n.y * k - y, n.z * k + flip(q, n.z))
}

/// `value` with its sign changed if `by` is negative.
fn flip(value: f32, by: f32) -> f32 {
    f32::from_bits(value.to_bits() ^ (by.to_bits() & 0x8000_0000))
}

#[cfg(test)]
mod tests {
    use optics_model::phase::PhaseFunction;

    use super::*;
    use crate::rng::Stream;
    use crate::testing::chi_square;

    const GS: [f64; 7] = [-0.9, -0.3, 0.0, 1e-4, 0.4, 0.8, 0.97];

    /// The mean over the cells' midpoints is an integral, not an estimate: it needs no tolerance for noise.
    #[test]
    fn mean_cosine_is_g() {
        for g in GS {
            let phase = PhaseFunction::new(g).sampler();
            let cells = 1 << 16;
            let mean: f64 = (0..cells).map(|i| f64::from(phase.cosine(symmetric(i << 16)))).sum::<f64>()
                / f64::from(cells);
            assert!((mean - g).abs() < 2e-6, "g {g}: {mean}");
        }
    }

    /// χ² over 50 cells with 400,000 samples at the 1e-4 level; a shift of g by 0.01 fails it.
    #[test]
    fn sampled_cosines_follow_the_density() {
        let chi = |sampled: f64, expected: f64| {
            let phase = PhaseFunction::new(sampled).sampler();
            let truth = PhaseFunction::new(expected);
            let mut counts = [0_u64; 50];
            for walk in 0..400_000 {
                let bits = Stream::new([7, 11], 0, walk).words()[0];
                let cell = (f64::from(phase.cosine(symmetric(bits))) + 1.0) * 25.0;
                counts[(cell as usize).min(49)] += 1;
            }
            let expected = |i: usize| {
                let sub = |k: usize| -1.0 + (i as f64 + (k as f64 + 0.5) / 200.0) / 25.0;
                (0..200).map(|k| truth.density(sub(k))).sum::<f64>() / 5000.0 * std::f64::consts::TAU
            };
            chi_square(&counts, &(0..50).map(expected).collect::<Vec<_>>())
        };
        for g in [-0.3, 0.0, 0.4, 0.8] {
            assert!(chi(g, g) > 1e-4, "g {g}: p = {}", chi(g, g));
            assert!(chi(g, g + 0.01) < 1e-4, "a wrong g must be noticed");
        }
    }

    /// A hundred thousand scatterings in a row, without normalisation.
    #[test]
    fn directions_stay_unit_vectors() {
        for g in [-0.6, 0.0, 0.6, 0.95, 0.999] {
            let phase = PhaseFunction::new(g).sampler();
            let mut direction = Vec3::new(0.0, 0.0, -1.0);
            let mut stream = Stream::new([3, 5], 1, 0);
            for _ in 0..100_000 {
                let bits = stream.words()[0];
                let scattered = scatter(&phase, direction, bits);
                let length = scattered.length();
                assert!((length - 1.0).abs() < 2e-5, "g {g}: length {length}");
                let cos = phase.cosine(symmetric(bits));
                assert!((scattered.dot(direction) - cos).abs() < 5e-5, "g {g}");
                direction = scattered;
            }
        }
    }

    /// The azimuth must be even about the old direction, whichever way that points: the mean of the part across
    /// it is 0. 40,000 samples, so that an error of 0.02 fails.
    #[test]
    fn scattering_is_even_about_the_old_direction() {
        let phase = PhaseFunction::new(0.3).sampler();
        for n in [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::new(0.6, -0.48, -0.64), Vec3::new(-0.48, 0.64, 0.6)] {
            let axis = n.any_orthonormal_vector();
            let (mut sum, mut squares) = (Vec3::ZERO, 0.0);
            for walk in 0..40_000 {
                let v = scatter(&phase, n, Stream::new([1, 9], 2, walk).words()[0]);
                let across = v - n * v.dot(n);
                sum += across;
                // Along one axis of the plane across n lies half of the square.
                squares += across.dot(axis).powi(2) / across.length_squared();
            }
            assert!(sum.length() / 40_000.0 < 0.015, "{n}: {sum}");
            assert!((squares / 40_000.0 - 0.5).abs() < 0.01, "{n}: {squares}");
        }
    }
}
