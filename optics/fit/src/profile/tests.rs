//! Tests profiles between the records of a dictionary that is computed from a formula.

use optics_model::Medium;
use optics_model::fit::ProfileQuestion;

use super::profile;
use crate::testing::{dense, dictionary, profile_value};

const PIXELS: u32 = 360;

fn question(medium: Medium, thickness_mm: f64, channels: &[&str]) -> ProfileQuestion {
    let channels = channels.iter().map(ToString::to_string).collect();
    ProfileQuestion::new(medium, thickness_mm, None, channels).unwrap()
}

/// In a dictionary of a formula with noise, values and derivatives between the records match the formula.
#[test]
fn interpolated_profiles_match_within_their_errors() {
    const NOISE: f64 = 0.002;
    let quiet = dense(PIXELS, 0.0);
    let noisy = dense(PIXELS, NOISE);
    let medium = Medium::new(3.1, 0.62, 0.33).unwrap();
    let question = question(medium, 0.5, &["G", "R"]);
    let [exact, found] = [&quiet, &noisy].map(|dictionary| profile(dictionary, &question).unwrap());
    assert!(!found.recorded);
    assert_eq!(found.channels.iter().map(|c| &*c.channel).collect::<Vec<_>>(), ["G", "R"]);
    let (smooth, channel) = (&exact.channels[0], &found.channels[0]);
    let errors = channel.std_errors.as_ref().unwrap();
    for (i, x) in found.pixels.x_mm().into_iter().enumerate() {
        let truth = profile_value(x, 3.1, 0.62, 0.33, 0.5, 1.0);
        assert!((smooth.values[i] / truth - 1.0).abs() < 1e-3, "{x}: {} for {truth}", smooth.values[i]);
        // Each record has an error of NOISE; the model averages some tens of records.
        let share = errors[i] / truth;
        assert!((0.1 * NOISE..0.7 * NOISE).contains(&share), "{x}: {share}");
        assert!((channel.values[i] - truth).abs() < 5.0 * errors[i] + 1e-3 * truth, "{x}");
    }
    // The derivative of the formula, away from the ends and averaged over some pixels.
    let middle = PIXELS as usize / 2;
    let step = 0.05;
    let at = |x: f64| profile_value(x, 3.1, 0.62, 0.33, 0.5, 1.0);
    let slope = (at(1.0 + step) - at(1.0 - step)) / (2.0 * step);
    let pitch = found.pixels.pitch_mm();
    let near = smooth.gradient[middle + (1.0 / pitch) as usize];
    assert!((near / slope - 1.0).abs() < 0.1, "{near} for {slope}");
}

/// A medium of the dictionary is marked as recorded, and too few records give no standard error.
#[test]
fn exact_record_is_marked_as_recorded() {
    let coarse = dictionary(PIXELS);
    let found = profile(&coarse, &question(Medium::new(2.0, 0.6, 0.4).unwrap(), 1.0, &[])).unwrap();
    assert!(found.recorded);
    assert_eq!(found.channels.len(), 1, "the first");
    assert_eq!(found.channels[0].std_errors, None, "eight records of a thickness");
}

/// Media, thicknesses and channels beyond the dictionary are refused with the field.
#[test]
fn questions_beyond_the_dictionary_are_refused() {
    let coarse = dictionary(PIXELS);
    for (medium, thickness_mm, channels, message) in [
        ((9.0, 0.6, 0.0), 0.5, &[][..], "sigma_t_per_mm = 9 is not valid"),
        ((2.0, 0.95, 0.0), 0.5, &[], "albedo = 0.95 is not valid: the dictionary reaches from 0.3 to 0.9"),
        ((2.0, 0.6, -0.1), 0.5, &[], "g = -0.1 is not valid"),
        ((2.0, 0.6, 0.0), 3.0, &[], "thickness_mm = 3 is not valid"),
        ((2.0, 0.6, 0.0), 0.5, &["X"], "channel = X is not valid: the dictionary has R, G, B"),
    ] {
        let medium = Medium::new(medium.0, medium.1, medium.2).unwrap();
        let refused = profile(&coarse, &question(medium, thickness_mm, channels)).unwrap_err().to_string();
        assert!(refused.starts_with(message), "{refused}");
    }
}
