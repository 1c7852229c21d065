//! Checks for standard errors in another unit than the values.

use super::trace::{median, scatter};
use super::{Kind, MeasuredProfile, Seen};

/// Ratios of standard errors and scatter beyond this, or below its inverse, are reported. Per cent in place of fractions
/// make a ratio of 100, for errors that are correct to a factor of two or so.
const FAR: f64 = 50.0;

/// Errors above this share of the brightest value are implausible. Those of simulated profiles are smaller, and hundreds
/// of times larger than the scatter of their pixels, which share walks.
const COARSE: f64 = 0.04;

/// Finds standard errors much larger or smaller than the scatter of neighbouring pixels, where this is independent noise.
pub(super) fn far_from_scatter(profile: &MeasuredProfile) -> Option<Seen> {
    let (values, stated) = (profile.values(), median(profile.std_errors()?.to_vec()));
    let (coarse, fine) = (scatter(values, 2), scatter(values, 4));
    // Higher differences of smooth values are smaller: they show no noise then. Rounding is not noise either, and the
    // pixels of a patch have one value.
    if stated == 0.0 || fine == 0.0 || fine < 0.5 * coarse || fine < 3.0 * last_digit(values) {
        return None;
    }
    let ratio = stated / fine;
    let text = |factor: f64, size: &str, cause: &str| {
        // The scatter of a few hundred pixels is accurate to 10 or 20 %.
        let digit = libm::pow(10f64, libm::log10(factor).floor());
        let factor = (factor / digit).round() * digit;
        format!(
            "its standard errors are about {factor} times {size} than the scatter of neighbouring pixels: {cause}"
        )
    };
    let most = values.iter().copied().fold(f64::MIN, f64::max);
    if ratio > FAR && stated > COARSE * most && !is_simulated(profile) {
        let cause = "they may be in per cent: divide them by 100";
        return Some(Seen::warning(Kind::ErrorScale, text(ratio, "larger", cause)));
    }
    let cause = "are they in another unit than the values, or of a mean over many profiles?";
    (ratio * FAR < 1.0).then(|| Seen::warning(Kind::ErrorScale, text(1.0 / ratio, "smaller", cause)))
}

/// Simulated profiles have an exact set-up.
fn is_simulated(profile: &MeasuredProfile) -> bool {
    let setup = profile.setup();
    setup.thickness_std_error_mm == Some(0.0) && setup.origin_std_error_mm == Some(0.0)
}

/// The smallest difference between values that are not the same.
fn last_digit(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let steps = sorted.windows(2).map(|w| w[1] - w[0]).filter(|step| *step > 0.0);
    let least = steps.fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::ProfileSetup;

    /// An edge with independent noise.
    fn profile(noise: f64, stated: f64) -> MeasuredProfile {
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let x: Vec<f64> = (0..180).map(|i| (f64::from(i) - 89.5) / 18.0).collect();
        // The sum of twelve uniform numbers is nearly normal.
        let mut normal = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        let values = x.iter().map(|x| 0.45 + 0.3 * libm::tanh(2.0 * x) + noise * normal()).collect();
        MeasuredProfile::new("R", 0.5, x, values, Some(vec![stated; 180])).unwrap()
    }

    /// Standard errors that look as if they were in another unit are reported with the factor.
    #[test]
    fn errors_in_another_unit_are_noted() {
        let message = |noise: f64, error: f64| far_from_scatter(&profile(noise, error)).map(|seen| seen.text);
        for right in [0.004, 0.002, 0.04, 0.0005] {
            assert_eq!(message(0.004, right), None);
        }
        let percent = message(0.004, 0.4).unwrap();
        assert!(percent.starts_with("its standard errors are about 100 times larger"), "{percent}");
        assert!(message(0.004, 0.00004).unwrap().contains("times smaller"));
    }

    /// Profiles without scatter, since they are smooth, rounded or simulated, are not reported; nor are errors that
    /// neighbouring pixels share.
    #[test]
    fn profiles_without_scatter_get_no_note() {
        let smooth = profile(0.0, 0.002);
        let rounded = smooth.values().iter().map(|v| (1e5 * v).round() / 1e5).collect();
        let errors = smooth.std_errors().map(<[f64]>::to_vec);
        let rounded = MeasuredProfile::new("R", 0.5, smooth.x_mm().to_vec(), rounded, errors).unwrap();
        let exact = (Some(0.0), Some(0.0));
        let exact = ProfileSetup {
            thickness_std_error_mm: exact.0,
            origin_std_error_mm: exact.1,
            ..Default::default()
        };
        let simulated = profile(0.001, 0.1).with_setup(exact).unwrap();
        let patch = MeasuredProfile::patch("R", 0.5, 0.08, 0.01).unwrap();
        for silent in [smooth, rounded, simulated, patch, profile(1e-5, 0.01)] {
            assert_eq!(far_from_scatter(&silent), None);
        }
    }
}
