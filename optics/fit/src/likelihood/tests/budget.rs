//! Compares the error budget with fits of data that are moved by one standard error of a source.

use optics_model::Measurement;
use optics_model::fit::{Bounds, ErrorSource, FitSettings, Refined};

use crate::testing::{changed, remade};

use super::{Flaws, MEDIUM, measured, refined, settings};

fn share(found: &Refined, source: ErrorSource) -> f64 {
    let budget = &found.likelihood.budget;
    budget.iter().find(|s| s.source == source).map_or(0.0, |s| s.sigma_t)
}

fn ln_sigma_t(found: &Refined) -> f64 {
    libm::log(found.best.medium.sigma_t_per_mm())
}

/// The shares of a budget add up to 1.
#[test]
fn budget_shares_sum_to_one() {
    for g in [settings().g, Bounds::fixed(MEDIUM.2)] {
        let found = refined(&measured(MEDIUM, 1, Flaws::default()), FitSettings { g, ..settings() });
        let budget = &found.likelihood.budget;
        let sums = budget.iter().fold([0.0; 4], |sum, s| {
            [sum[0] + s.sigma_t, sum[1] + s.albedo, sum[2] + s.reduced_scattering, sum[3] + s.absorption]
        });
        assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-6), "{sums:?}");
        assert!(budget.iter().all(|s| s.sigma_t >= 0.0 && s.absorption >= 0.0), "{budget:?}");
    }
}

/// The share of g is the part of σ_t's variance that is due to g being free.
#[test]
fn share_of_g_is_its_variance_increase() {
    let data = measured(MEDIUM, 2, Flaws::default());
    let free = refined(&data, settings());
    let held = refined(&data, FitSettings { g: Bounds::fixed(free.best.medium.g()), ..settings() });
    let grown = 1.0 - held.covariance[0][0] / free.covariance[0][0];
    let found = share(&free, ErrorSource::G);
    assert!(grown > 0.05 && (found - grown).abs() < 0.02, "{found} {grown}");
    assert_eq!(share(&held, ErrorSource::G), 0.0);
}

/// A shift of one profile by one standard error of a source moves the estimate by the root of that profile's part of the
/// variance; errors of profiles are independent.
#[test]
fn share_is_the_response_to_one_error() {
    let errors = FitSettings {
        g: Bounds::fixed(MEDIUM.2),
        offset_std_error: 0.004,
        slope_std_error: 0.01,
        gain_std_error: 0.004,
        ..settings()
    };
    let data = measured(MEDIUM, 3, Flaws::default());
    let found = refined(&data, errors);
    for (source, move_pixel) in [
        (ErrorSource::Zero, (|v, _| v + 0.004) as fn(f64, f64) -> f64),
        (ErrorSource::Slope, |v, x| v * (1.0 + 0.01 * x / 10.0)),
        (ErrorSource::Gain, |v, _| 1.004 * v),
    ] {
        let response =
            |profile| ln_sigma_t(&refined(&moved(&data, profile, move_pixel), errors)) - ln_sigma_t(&found);
        let variance: f64 = (0..2).map(|profile| response(profile).powi(2)).sum();
        let (share, wanted) = (share(&found, source), variance / found.covariance[0][0]);
        assert!(wanted > 1e-3 && (share / wanted - 1.0).abs() < 0.1, "{source:?}: {share} {wanted}");
    }
}

/// The measurement with other values in one of its profiles.
fn moved(data: &Measurement, which: usize, move_pixel: fn(f64, f64) -> f64) -> Measurement {
    let mut number = 0..;
    remade(data, |p| {
        let is_moved = number.next() == Some(which);
        changed(p, |x, v, e| (if is_moved { move_pixel(v, x) } else { v }, Some(e)))
    })
}
