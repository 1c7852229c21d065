//! Decomposes the noise of the dictionary's records into modes: it is correlated between neighbouring pixels, since a
//! walk contributes to many of them.

use crate::dictionary::sum::dot;
use crate::dictionary::wide::wide;
use crate::likelihood::point::Line;
use crate::likelihood::term::camera::Camera;
use crate::surrogate::NoiseFactors;

/// Maximum number of modes.
const MODES: usize = 20;
/// Modes are added until they leave less than this, as a sum over pixels of variances over the pixels' own: no functional
/// of the pixels could detect the remainder with more than this χ².
const LEFT: f64 = 0.2;
/// Maximum factor on variances that are estimated from few profiles.
const MOST: f64 = 10.0;

/// A low-rank part of a covariance, and the variances that it leaves.
#[derive(Debug, Default)]
pub(crate) struct Modes {
    pub modes: Vec<Line>,
    pub rest_variances: Line,
}

impl Modes {
    /// Decomposes the covariance Σ f fᵀ on the pixels of a camera, relative to pixels of these standard errors: a Cholesky
    /// decomposition that takes the pixel with the largest variance first, and stops when little is left.
    ///
    /// The covariance is estimated from a number of profiles n, and its inverse is then too large by (n − 1)/(n − p − 2) on
    /// average, p being the number of directions in which it counts (Hartlap et al. 2007, "Why your model parameter
    /// confidences might be too optimistic"). All variances are multiplied by that.
    pub(crate) fn new(noise: &NoiseFactors, camera: &Camera, origin_mm: f64, std_errors: &[f64]) -> Self {
        let seen = camera.sharp(&noise.factors, origin_mm);
        let n = std_errors.len();
        let at_pixel: Vec<Line> = (0..n).map(|i| seen.iter().map(|f| f[i]).collect()).collect();
        let mut rest_variances: Line = at_pixel.iter().map(|f| dot(f, f)).collect();
        let mut modes: Vec<Line> = Vec::new();
        while modes.len() < MODES {
            let share = |i: &usize| rest_variances[*i] / std_errors[*i].powi(2);
            if (0..n).map(|i| share(&i)).sum::<f64>() < LEFT {
                break;
            }
            let Some(pivot) = (0..n).max_by(|a, b| share(a).total_cmp(&share(b))) else { break };
            let size = rest_variances[pivot].sqrt();
            let products: Line = wide(
                #[inline(always)]
                || at_pixel.iter().map(|f| dot(f, &at_pixel[pivot])).collect(),
            );
            let known = |i: usize| modes.iter().map(|m: &Line| m[i] * m[pivot]).sum::<f64>();
            let mode: Line =
                products.iter().enumerate().map(|(i, product)| (product - known(i)) / size).collect();
            rest_variances.iter_mut().zip(&mode).for_each(|(v, m)| *v = (*v - m * m).max(0.0));
            modes.push(mode);
        }
        let factor = too_small_by(noise.degrees, modes.len());
        for v in modes.iter_mut().flatten() {
            *v *= factor.sqrt();
        }
        for v in &mut rest_variances {
            *v *= factor;
        }
        Self { modes, rest_variances }
    }
}

/// Factor by which a covariance of `degrees` profiles is too small in the directions that count.
fn too_small_by(degrees: f64, directions: usize) -> f64 {
    let left = degrees - directions as f64 - 2.0;
    match directions {
        0 => 1.0,
        _ if left > 0.0 => ((degrees - 1.0) / left).min(MOST),
        _ => MOST,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fewer profiles support a covariance, the larger the factor it is multiplied by, up to a limit.
    #[test]
    fn few_profiles_enlarge_the_covariance() {
        assert_eq!(
            [too_small_by(0.0, 0), too_small_by(30.0, 8), too_small_by(1e9, 8).round()],
            [1.0, 1.45, 1.0]
        );
        // With as many directions as profiles, or more, the covariance is undetermined.
        assert_eq!([too_small_by(10.5, 8), too_small_by(8.0, 8), too_small_by(1.2, 1)], [MOST; 3]);
    }

    /// Noise counts by its variance over that of the measured pixel on which it falls. Where the pixel's own noise hides
    /// it, it stays on the diagonal.
    #[test]
    fn hidden_noise_becomes_no_mode() {
        let n = 20;
        let at = |pixel: usize, size: f64| -> Line {
            (0..n).map(|i| if i == pixel { size } else { 0.0 }).collect()
        };
        let mut std_errors = vec![1.0; n];
        (std_errors[8], std_errors[12]) = (3.0, 0.1);
        let x: Line = (0..n).map(|i| (i as f64 + 0.5) * 0.5 - 5.0).collect();
        let camera = Camera::new(&x, 0.5, 10.0, n);
        let noise = NoiseFactors { factors: vec![at(8, 1.0), at(12, 0.3)], degrees: 30.0 };
        let found = Modes::new(&noise, &camera, 0.0, &std_errors);
        let factor: f64 = 29.0 / 27.0;
        let (mode, rest) = (at(12, 0.3 * factor.sqrt()), at(8, factor));
        assert_eq!(found.modes.len(), 1);
        for i in 0..n {
            assert!((found.modes[0][i] - mode[i]).abs() < 1e-9, "mode at pixel {i}");
            assert!((found.rest_variances[i] - rest[i]).abs() < 1e-9, "rest at pixel {i}");
        }
        // An edge that lies a pixel further right.
        let moved = Modes::new(&noise, &camera, 0.5, &std_errors);
        assert!((moved.modes[0][9] - factor.sqrt()).abs() < 1e-9, "{:?}", moved.modes[0]);
    }

    /// A few modes contain nearly all of a smooth noise, and the remainder is on the diagonal.
    #[test]
    fn modes_and_remainder_form_the_covariance() {
        let n = 60;
        let factor = |k: usize| -> Line {
            (0..n).map(|i| libm::cos((i * k) as f64 * 0.05) / (1.0 + k as f64).powi(2)).collect()
        };
        let factors: Vec<Line> = (0..30).map(factor).collect();
        let pitch = 10.0 / n as f64;
        let x: Line = (0..n).map(|i| (i as f64 + 0.5) * pitch - 5.0).collect();
        let camera = Camera::new(&x, pitch, 10.0, n);
        let degrees = 30.0;
        let noise = NoiseFactors { factors, degrees };
        let found = Modes::new(&noise, &camera, 0.0, &vec![0.1; n]);
        assert!((1..20).contains(&found.modes.len()), "{}", found.modes.len());
        let factor = 29.0 / (28.0 - found.modes.len() as f64);
        let whole = |i: usize, k: usize| factor * noise.factors.iter().map(|f| f[i] * f[k]).sum::<f64>();
        let kept = |i: usize, k: usize| found.modes.iter().map(|m| m[i] * m[k]).sum::<f64>();
        for i in 0..n {
            assert!((kept(i, i) + found.rest_variances[i] - whole(i, i)).abs() < 1e-9);
            for k in 0..n {
                let bound = (found.rest_variances[i] * found.rest_variances[k]).sqrt() + 1e-9;
                assert!((kept(i, k) - whole(i, k)).abs() <= bound);
            }
        }
    }
}
