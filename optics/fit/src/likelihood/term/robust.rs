//! Weights residuals that may be dust, by a mixture of normal pixels and a few outliers.
//!
//! With ε the share of outliers and κ the width of their distribution, in standard deviations of the noise,
//!
//! ρ(r) = −2 ln[(1 − ε) e^{−r²/2} + (ε/κ) e^{−r²/(2κ²)}], less its value at 0.
//!
//! Without outliers this is r², but for a share of about ε; beyond some four standard deviations a pixel hardly counts. ρ
//! is concave in r², so least squares that are reweighted by w = dρ/d(r²) never raise the cost.

/// Assumed share of outliers.
const SHARE: f64 = 0.01;
/// Width of the distribution of outliers, in standard deviations of the noise.
const WIDTH: f64 = 30.0;
/// A pixel with a lower weight is an outlier.
const ODD: f64 = 0.5;
/// Maximum number of pixels by which a speck extends beyond its outliers.
const RIM: usize = 4;
/// A speck extends over residuals of its sign, while they are above this many standard deviations.
const RIM_LEVEL: f64 = 0.5;

/// Deviation of a pixel from its neighbours, in standard deviations, above which it is a speck before any fit.
const SPECK: f64 = 6.0;
/// Longest run of pixels that specks cause, two or three together.
const LONGEST: usize = 24;
/// Greatest share of pixels that can be dust.
const DUST: f64 = 0.4;

fn parts(r: f64) -> (f64, f64) {
    let square = r * r;
    ((1.0 - SHARE) * libm::exp(-0.5 * square), SHARE / WIDTH * libm::exp(-0.5 * square / (WIDTH * WIDTH)))
}

/// ρ(r), zero at 0.
pub(crate) fn rho(r: f64) -> f64 {
    let (normal, odd) = parts(r);
    let at_zero = 1.0 - SHARE + SHARE / WIDTH;
    -2.0 * libm::log((normal + odd).max(f64::MIN_POSITIVE) / at_zero)
}

/// dρ/d(r²): close to 1 for inliers.
pub(crate) fn weight(r: f64) -> f64 {
    let (normal, odd) = parts(r);
    (normal + odd / (WIDTH * WIDTH)) / (normal + odd).max(f64::MIN_POSITIVE)
}

/// Whether outliers form runs as short as those of specks, and are not too many: otherwise the model is wrong.
pub(crate) fn is_dust(left_out: &[bool]) -> bool {
    let count = left_out.iter().filter(|o| **o).count();
    let longest = left_out.split(|o| !o).map(<[bool]>::len).max().unwrap_or(0);
    longest <= LONGEST && count as f64 <= DUST * left_out.len() as f64
}

/// Outliers, with the rims of their specks.
pub(crate) fn specks(residuals: &[f64]) -> Vec<bool> {
    let n = residuals.len();
    let odd: Vec<bool> = residuals.iter().map(|r| weight(*r) < ODD).collect();
    let mut left_out = odd.clone();
    for i in (0..n).filter(|i| odd[*i]) {
        let belongs = |k: usize| residuals[k] * residuals[i].signum() > RIM_LEVEL;
        (i + 1..n.min(i + 1 + RIM)).take_while(|k| belongs(*k)).for_each(|k| left_out[k] = true);
        (i.saturating_sub(RIM)..i).rev().take_while(|k| belongs(*k)).for_each(|k| left_out[k] = true);
    }
    left_out
}

/// Pixels close to their neighbours, by a median filter; specks and their rims are excluded.
pub(crate) fn without_specks(values: &[f64], std_errors: &[f64]) -> Vec<bool> {
    let n = values.len();
    let apart = |i: usize| {
        let mut near: Vec<f64> = values[i.saturating_sub(4)..(i + 5).min(n)].to_vec();
        near.sort_by(f64::total_cmp);
        let spread = near[near.len() - 2] - near[1];
        (values[i] - near[near.len() / 2]).abs() > SPECK * std_errors[i] + spread
    };
    let odd: Vec<bool> = (0..n).map(apart).collect();
    (0..n).map(|i| !odd[i.saturating_sub(2)..(i + 3).min(n)].contains(&true)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_the_slope_of_rho() {
        for r in [0.0_f64, 0.5, 2.0, 3.7, 4.2, 6.0, 40.0] {
            let step = 1e-6;
            let (low, high) = (r * r - step, r * r + step);
            if low > 0.0 {
                let slope = (rho(high.sqrt()) - rho(low.sqrt())) / (2.0 * step);
                assert!((slope - weight(r)).abs() < 1e-6 * (1.0 + slope), "{r}: {slope} {}", weight(r));
            }
        }
        assert!(rho(0.0) == 0.0 && (rho(1.0) - 1.0).abs() < 1e-3 && rho(100.0) < 30.0);
        assert!(weight(2.0) > 0.99 && weight(6.0) < 0.01);
    }

    /// At most four pixels on each side belong to a speck, up to the first of another sign.
    #[test]
    fn rims_end_after_four_pixels() {
        let mut residuals = vec![-1.0; 13];
        residuals[6] = -9.0;
        let excluded = |residuals: &[f64]| -> Vec<usize> {
            specks(residuals).iter().enumerate().filter(|(_, out)| **out).map(|(i, _)| i).collect()
        };
        assert_eq!(excluded(&residuals), [2, 3, 4, 5, 6, 7, 8, 9, 10]);
        (residuals[4], residuals[8]) = (1.0, 1.0);
        assert_eq!(excluded(&residuals), [5, 6, 7]);
    }

    /// Dust makes runs of 24 pixels and 40 % of a profile at most.
    #[test]
    fn longest_run_and_share_bound_dust() {
        let runs = |length: usize, of: usize| (0..400).map(|i| i % of < length).collect::<Vec<bool>>();
        assert!(is_dust(&runs(24, 100)) && !is_dust(&runs(25, 100)));
        assert!(is_dust(&runs(2, 5)) && !is_dust(&runs(21, 50)));
    }

    /// A speck is excluded together with its rim.
    #[test]
    fn speck_is_excluded_with_its_rim() {
        let mut residuals = vec![0.4, -0.7, 0.2, 0.9, -0.1, 0.3, -0.4, 0.1];
        assert!(specks(&residuals).iter().all(|s| !s));
        residuals.splice(2..6, [-1.5, -9.0, -3.0, -0.2]);
        assert_eq!(specks(&residuals), [false, true, true, true, true, false, false, false]);
    }
}
