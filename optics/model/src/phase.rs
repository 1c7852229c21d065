//! The phase function of the sample: sampling, density and azimuthal mean, each written once for all users.
//!
//! The tracer samples it, for one walk or for a vector of walks, and scores with the azimuthal mean; the fit's surrogate
//! takes the shapes of its interpolation from the density.

use std::f64::consts::PI;
use std::ops::{Add, Div, Mul};

/// Henyey–Greenstein phase function with anisotropy g:
/// p(cos θ) = (1 − g²) / (4π (1 + g² − 2 g cos θ)^{3/2}), in 1/sr.
#[derive(Debug, Clone, Copy)]
pub struct PhaseFunction {
    g: f64,
}

impl PhaseFunction {
    /// `g` lies in (−1, 1).
    pub fn new(g: f64) -> Self {
        Self { g }
    }

    /// The mean cosine of the scattering angle.
    pub fn anisotropy(self) -> f64 {
        self.g
    }

    /// 4π p(cos θ): the density as a multiple of isotropic scattering's.
    pub fn over_isotropic(self, cosine: f64) -> f64 {
        let g = self.g;
        let square = 1.0 + g * g - 2.0 * g * cosine;
        (1.0 - g * g) / (square * square.sqrt())
    }

    /// The density per steradian.
    pub fn density(self, cosine: f64) -> f64 {
        self.over_isotropic(cosine) / (4.0 * PI)
    }

    /// The density for light that goes down with the cosine μ and a walk that comes with the cosine u, averaged over the
    /// azimuth between them, in 1/sr. With the cosine of the angle uμ + √((1 − u²)(1 − μ²)) cos φ it is
    ///
    /// (1 − g²)/(4π) · (2/π) E(m)/((a − b) √(a + b)), a = 1 + g² − 2guμ, b = 2|g| √((1 − u²)(1 − μ²)), m = 2b/(a + b),
    ///
    /// E being the complete elliptic integral (Gradshteyn and Ryzhik 2.575).
    pub fn azimuthal_mean(self, u: f64, mu: f64) -> f64 {
        let g = self.g;
        let a = 1.0 + g * g - 2.0 * g * u * mu;
        let b = 2.0 * g.abs() * ((1.0 - u * u).max(0.0) * (1.0 - mu * mu).max(0.0)).sqrt();
        let sum = a + b;
        (1.0 - g * g) / (4.0 * PI) * elliptic(2.0 * b / sum) / ((a - b) * sum.sqrt())
    }

    pub fn sampler(self) -> PhaseSampler {
        let g = self.g;
        let numerator = [g * (1.0 + g * g) / 2.0, 1.0 + g * g, g * (3.0 - g * g) / 2.0];
        PhaseSampler { g: g as f32, numerator: numerator.map(|v| v as f32) }
    }
}

/// Samples a [`PhaseFunction`] in single precision.
#[derive(Debug, Clone, Copy)]
pub struct PhaseSampler {
    g: f32,
    /// g (1 + g²)/2, 1 + g², g (3 − g²)/2: the numerator's coefficients, highest power first.
    numerator: [f32; 3],
}

impl PhaseSampler {
    /// The phase function of the rounded anisotropy.
    pub fn function(&self) -> PhaseFunction {
        PhaseFunction::new(f64::from(self.g))
    }

    /// Cosine of the scattering angle from a number uniform in (−1, 1), or from each lane of a vector of them, with the same
    /// bits.
    ///
    /// The inverse of the distribution function, written without a division by g:
    /// cos θ = [gξ²(1+g²)/2 + ξ(1+g²) + g(3−g²)/2] / (1+gξ)², good for every g including 0. Rounding may
    /// carry it past ±1 by an ulp or two.
    #[expect(
        clippy::inline_always,
        reason = "the vector kernel compiles for its instructions what is inlined into it"
    )]
    #[inline(always)]
    pub fn cosine<L>(&self, xi: L) -> L
    where
        L: Copy + Add<f32, Output = L> + Add<Output = L> + Mul<f32, Output = L> + Mul<Output = L>,
        L: Div<Output = L>,
    {
        let [c2, c1, c0] = self.numerator;
        let root = xi * self.g + 1.0;
        ((xi * c2 + c1) * xi + c0) / (root * root)
    }
}

/// (2/π) E(m), by the arithmetic–geometric mean (Abramowitz and Stegun 17.6).
fn elliptic(m: f64) -> f64 {
    let (mut a, mut b, mut c2) = (1.0, (1.0 - m).max(0.0).sqrt(), m);
    let (mut sum, mut power) = (0.5 * c2, 0.5);
    while c2 > 1e-16 {
        (a, b, c2) = (0.5 * (a + b), (a * b).sqrt(), (0.5 * (a - b)).powi(2));
        power *= 2.0;
        sum += power * c2;
    }
    (1.0 - sum) / a
}

#[cfg(test)]
mod tests {
    use super::*;

    const GS: [f64; 8] = [-0.9, -0.3, 0.0, 1e-4, 0.4, 0.8, 0.95, 0.97];

    #[test]
    fn density_integrates_to_one_over_the_sphere() {
        for g in GS {
            let phase = PhaseFunction::new(g);
            let n = 2_000_000;
            let sum: f64 =
                (0..n).map(|i| phase.density(-1.0 + (f64::from(i) + 0.5) * 2.0 / f64::from(n))).sum();
            let integral = sum * 2.0 / f64::from(n) * std::f64::consts::TAU;
            assert!((integral - 1.0).abs() < 1e-6, "g {g}: {integral}");
        }
    }

    /// The trapezoidal rule over the azimuth converges faster than any power.
    #[test]
    fn azimuthal_mean_matches_the_density() {
        for g in GS.into_iter().filter(|g| *g < 0.96) {
            let phase = PhaseFunction::new(g);
            for u in [-1.0, -0.7, -0.1, 0.3, 0.9, 1.0] {
                for mu in [0.05, 0.5, 0.88, 1.0_f64] {
                    let n = 20_000;
                    let at = |i: i32| {
                        let phi = 2.0 * PI * f64::from(i) / f64::from(n);
                        let across = ((1.0 - u * u) * (1.0 - mu * mu)).sqrt();
                        phase.density(u * mu + across * phi.cos())
                    };
                    let mean = (0..n).map(at).sum::<f64>() / f64::from(n);
                    let found = phase.azimuthal_mean(u, mu);
                    assert!((found / mean - 1.0).abs() < 1e-10, "g {g}, u {u}, μ {mu}: {found}, not {mean}");
                }
            }
        }
    }
}
