//! The Henyey–Greenstein phase function.

use glam::Vec3;

use super::math::sin_cos_turns;

/// Henyey–Greenstein phase function with anisotropy g:
/// p(cos θ) = (1 − g²) / (4π (1 + g² − 2 g cos θ)^{3/2}), in 1/sr.
#[derive(Debug, Clone, Copy)]
pub struct HenyeyGreenstein {
    g: f32,
    /// (1 + g²), g (3 − g²)/2, g (1 + g²)/2: the numerator's coefficients.
    numerator: [f32; 3],
}

impl HenyeyGreenstein {
    pub fn new(g: f64) -> Self {
        let numerator = [1.0 + g * g, g * (3.0 - g * g) / 2.0, g * (1.0 + g * g) / 2.0];
        Self { g: g as f32, numerator: numerator.map(|v| v as f32) }
    }

    /// Cosine of the scattering angle from a uniform number.
    ///
    /// The inverse of the distribution function, with ξ = 2u − 1 written without a division by g:
    /// cos θ = [ξ(1+g²) + g(3−g²)/2 + gξ²(1+g²)/2] / (1+gξ)², good for every g including 0.
    pub fn sample_cosine(&self, u: f32) -> f32 {
        let xi = 2.0 * u - 1.0;
        let [a, b, c] = self.numerator;
        let root = 1.0 + self.g * xi;
        ((a * xi + (c * xi * xi + b)) / (root * root)).clamp(-1.0, 1.0)
    }

    /// Direction after scattering of the unit vector `direction`.
    #[inline]
    pub fn scatter(&self, direction: Vec3, u_cosine: f32, u_azimuth: f32) -> Vec3 {
        let cos = self.sample_cosine(u_cosine);
        let sin = (1.0 - cos * cos).sqrt();
        let (sin_phi, cos_phi) = sin_cos_turns(u_azimuth);
        let turned = rotate(direction, sin * cos_phi, sin * sin_phi, cos);
        // One Newton step keeps the length at 1 over any number of events.
        turned * (1.5 - 0.5 * turned.length_squared())
    }

    /// Density per steradian: what the samples are tested against.
    #[cfg(test)]
    pub fn pdf(&self, cos: f64) -> f64 {
        let g = f64::from(self.g);
        let d = 1.0 + g * g - 2.0 * g * cos;
        (1.0 - g * g) / (4.0 * std::f64::consts::PI * d * d.sqrt())
    }
}

/// Combines coordinates relative to the unit vector `n` (Duff et al. 2017, "Building an orthonormal
/// basis, revisited").
fn rotate(n: Vec3, x: f32, y: f32, z: f32) -> Vec3 {
    let sign = 1.0_f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let tangent = Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    let bitangent = Vec3::new(b, sign + n.y * n.y * a, -n.y);
    tangent * x + bitangent * y + n * z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracer::rng::Stream;
    use crate::tracer::testing::chi_square;

    const GS: [f64; 7] = [-0.9, -0.3, 0.0, 1e-4, 0.4, 0.8, 0.97];

    #[test]
    fn pdf_integrates_to_one_over_the_sphere() {
        for g in GS {
            let phase = HenyeyGreenstein::new(g);
            let n = 2_000_000;
            let sum: f64 = (0..n).map(|i| phase.pdf(-1.0 + (f64::from(i) + 0.5) * 2.0 / f64::from(n))).sum();
            let integral = sum * 2.0 / f64::from(n) * std::f64::consts::TAU;
            assert!((integral - 1.0).abs() < 1e-6, "g {g}: {integral}");
        }
    }

    /// The mean over the cells' midpoints is an integral, not an estimate: it needs no tolerance for noise.
    #[test]
    fn mean_cosine_is_g() {
        for g in GS {
            let phase = HenyeyGreenstein::new(g);
            let cells = 1 << 20;
            let mean: f64 = (0..cells)
                .map(|i| f64::from(phase.sample_cosine((i as f32 + 0.5) / cells as f32)))
                .sum::<f64>()
                / f64::from(cells);
            assert!((mean - g).abs() < 2e-6, "g {g}: {mean}");
        }
    }

    /// χ² over 50 cells with 400,000 samples at the 1e-4 level; a shift of g by 0.01 fails it.
    #[test]
    fn sampled_cosines_follow_the_pdf() {
        let chi = |sampled: f64, expected: f64| {
            let phase = HenyeyGreenstein::new(sampled);
            let truth = HenyeyGreenstein::new(expected);
            let mut counts = [0_u64; 50];
            for walk in 0..400_000 {
                let u = Stream::new([7, 11], 0, walk).next();
                let cell = (f64::from(phase.sample_cosine(u[0])) + 1.0) * 25.0;
                counts[(cell as usize).min(49)] += 1;
            }
            let expected = |i: usize| {
                let sub = |k: usize| -1.0 + (i as f64 + (k as f64 + 0.5) / 200.0) / 25.0;
                (0..200).map(|k| truth.pdf(sub(k))).sum::<f64>() / 5000.0 * std::f64::consts::TAU
            };
            chi_square(&counts, &(0..50).map(expected).collect::<Vec<_>>())
        };
        for g in [-0.3, 0.0, 0.4, 0.8] {
            assert!(chi(g, g) > 1e-4, "g {g}: p = {}", chi(g, g));
            assert!(chi(g, g + 0.01) < 1e-4, "a wrong g must be noticed");
        }
    }

    #[test]
    fn directions_stay_unit_vectors_at_the_sampled_angle() {
        let phase = HenyeyGreenstein::new(0.6);
        let mut direction = Vec3::new(0.0, 0.0, -1.0);
        for walk in 0..100_000 {
            let u = Stream::new([3, 5], 1, walk).next();
            let scattered = phase.scatter(direction, u[0], u[1]);
            assert!((scattered.length() - 1.0).abs() < 1e-6);
            assert!((scattered.dot(direction) - phase.sample_cosine(u[0])).abs() < 2e-6);
            direction = scattered;
        }
    }
}
