//! The phase function of the sample: its parameters, density and azimuthal mean, each written once for all users.
//!
//! The tracer samples it and scores with the azimuthal mean; the fit's surrogate takes the shapes of its interpolation from
//! the density.

use std::f64::consts::PI;

use serde::Serialize;

use crate::invalid::{Result, check};

/// Refuses a value that is not a usable Henyey–Greenstein anisotropy.
pub fn check_g(value: f64) -> Result<f64> {
    check("g", value, |v| v.abs() <= 0.999, "allowed are -0.999 to 0.999")
}

/// Henyey–Greenstein phase function with anisotropy g:
/// p(cos θ) = (1 − g²) / (4π (1 + g² − 2 g cos θ)^{3/2}), in 1/sr.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize)]
pub struct PhaseFunction {
    g: f64,
}

impl PhaseFunction {
    pub fn new(g: f64) -> Result<Self> {
        Ok(Self { g: check_g(g)? })
    }

    /// The phase function with g = 1 − e^y: the coordinate of a grid's anisotropies in the fit, for any y below ln 2.
    #[must_use]
    pub fn at_ln_one_minus_g(self, y: f64) -> Self {
        Self { g: 1.0 - y.exp() }
    }

    /// This phase function with all parameters in the precision of walks.
    #[must_use]
    pub fn in_single_precision(self) -> Self {
        Self { g: f64::from(self.g as f32) }
    }

    /// All parameters that distinguish phase functions, for digests.
    pub fn parameters(self) -> [f64; 1] {
        [self.g]
    }

    pub fn g(self) -> f64 {
        self.g
    }

    /// The mean cosine of the scattering angle.
    pub fn anisotropy(self) -> f64 {
        self.g
    }

    /// 1 − |g|: the angle in radians over which a narrow peak of the density falls to a third.
    pub fn peak_width(self) -> f64 {
        1.0 - self.g.abs()
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

    /// The density for light that goes down with the cosine μ and a walk that arrives with the cosine u, averaged over
    /// the azimuth between them, in 1/sr. With the cosine of the angle uμ + √((1 − u²)(1 − μ²)) cos φ it is
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
            let phase = PhaseFunction::new(g).unwrap();
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
            let phase = PhaseFunction::new(g).unwrap();
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
