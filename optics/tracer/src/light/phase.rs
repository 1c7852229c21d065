//! The phase function averaged over the azimuth.

use std::f64::consts::PI;

/// Henyey–Greenstein's phase function for light that goes down with the cosine μ and a walk that comes with the cosine u,
/// averaged over the azimuth between them, in 1/sr. With the cosine of the angle uμ + √((1 − u²)(1 − μ²)) cos φ it is
///
/// (1 − g²)/(4π) · (2/π) E(m)/((a − b) √(a + b)), a = 1 + g² − 2guμ, b = 2|g| √((1 − u²)(1 − μ²)), m = 2b/(a + b),
///
/// E being the complete elliptic integral (Gradshteyn and Ryzhik 2.575).
pub fn mean_phase(g: f64, u: f64, cosine: f64) -> f64 {
    let a = 1.0 + g * g - 2.0 * g * u * cosine;
    let b = 2.0 * g.abs() * ((1.0 - u * u).max(0.0) * (1.0 - cosine * cosine).max(0.0)).sqrt();
    let sum = a + b;
    (1.0 - g * g) / (4.0 * PI) * elliptic(2.0 * b / sum) / ((a - b) * sum.sqrt())
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

    /// The trapezoidal rule over the azimuth converges faster than any power.
    #[test]
    fn the_mean_over_the_azimuth_is_that_of_the_phase_function() {
        for g in [-0.9, -0.3, 0.0, 0.4, 0.8, 0.95] {
            for u in [-1.0, -0.7, -0.1, 0.3, 0.9, 1.0] {
                for mu in [0.05, 0.5, 0.88, 1.0_f64] {
                    let n = 20_000;
                    let at = |i: i32| {
                        let phi = 2.0 * PI * f64::from(i) / f64::from(n);
                        let cos = u * mu + ((1.0 - u * u) * (1.0 - mu * mu)).sqrt() * phi.cos();
                        (1.0 - g * g) / (4.0 * PI) * (1.0 + g * g - 2.0 * g * cos).powf(-1.5)
                    };
                    let mean = (0..n).map(at).sum::<f64>() / f64::from(n);
                    let found = mean_phase(g, u, mu);
                    assert!((found / mean - 1.0).abs() < 1e-10, "g {g}, u {u}, μ {mu}: {found}, not {mean}");
                }
            }
        }
    }
}
