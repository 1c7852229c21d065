//! Answers as tests want them.

use optics_model::Medium;
use optics_model::fit::{Candidate, Cause, ChannelFit, Interval, Refined, Suspicion};

/// From 0 open below, beyond 1 open above.
pub(crate) fn interval(low: f64, high: f64) -> Interval {
    Interval { low, high, open_low: low == 0.0, open_high: high > 1.0 }
}

pub(crate) fn candidate(sigma_t_per_mm: f64) -> Candidate {
    let medium = Medium::new(sigma_t_per_mm, 0.999_827, 0.534_7).unwrap();
    Candidate { medium, sample_ior: 1.53, error: 0.0626, thicknesses: Vec::new() }
}

/// A channel whose σ_t is this, and that of its best record a whole number; with a suspicion if the misfit is above 2.
pub(crate) fn channel(name: &str, sigma_t_per_mm: f64, misfit: f64) -> ChannelFit {
    let closed = |low, high| Interval { low, high, open_low: false, open_high: false };
    let suspicion =
        Suspicion { cause: Cause::EdgeOffset, thickness_mm: Some(0.5), amount: 0.0712, misfit_left: 1.04 };
    let refined = Refined {
        best: candidate(sigma_t_per_mm),
        resolved: true,
        valley: true,
        sigma_t_per_mm: closed(0.9 * sigma_t_per_mm, 1.1 * sigma_t_per_mm),
        albedo: closed(0.999_494, 0.999_986),
        g: closed(0.4123, 0.6312),
        reduced_scattering_per_mm: closed(13.46, 14.52),
        absorption_per_mm: closed(0.000_174, 0.005_93),
        covariance: [[0.0; 3]; 3],
        correlation: 0.0,
        measurement_noise: 0.01,
        dictionary_share: 0.1,
        misfit,
        suspicion: (misfit > 2.0).then_some(suspicion),
        likelihood: None,
    };
    ChannelFit {
        channel: name.to_owned(),
        candidates: vec![candidate(sigma_t_per_mm.ceil())],
        refined: Some(refined),
        outside: None,
        curves: Vec::new(),
    }
}
