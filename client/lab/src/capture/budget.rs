//! Sums error budgets of single profiles, and the errors that all profiles of a session share.

use optics_capture::{Contribution, Source};
use serde::Serialize;

use super::stage::{Captured, CapturedSample};

/// Errors that all profiles of a session share, named as in session files. An estimate from the few mountings of one
/// profile is uncertain, so squares are averaged over all profiles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SessionErrors {
    /// Standard error of each profile's own gain: light, mounting, linearity.
    pub gain_std_error: f64,
    /// Standard error of each profile's zero: black level, stray light.
    pub offset_std_error: f64,
    /// Per 10 mm.
    pub slope_std_error: f64,
    pub origin_std_error_mm: f64,
    /// Standard error of the gain that all profiles share: the white reference.
    pub mu_std_error: f64,
}

impl SessionErrors {
    pub fn of(captured: &Captured) -> Self {
        let profiles = 3.0 * captured.samples.len().max(1) as f64;
        let pooled = |sources: &[Source]| {
            let squares = |sample: &CapturedSample| {
                (0..3).map(|c| sum(&sample.profile.budget, sources, c).powi(2)).sum::<f64>()
            };
            (captured.samples.iter().map(squares).sum::<f64>() / profiles).sqrt().min(1.0)
        };
        Self {
            gain_std_error: pooled(&[Source::Drift, Source::Mounting, Source::Linearity]),
            offset_std_error: pooled(&[Source::Black, Source::Glare]),
            slope_std_error: pooled(&[Source::Slope]),
            origin_std_error_mm: pooled(&[Source::Origin]),
            mu_std_error: captured.calibration.reference_std_error,
        }
    }
}

/// Standard error of a channel due to several independent sources.
pub(super) fn sum(budget: &[Contribution], sources: &[Source], c: usize) -> f64 {
    let of = budget.iter().filter(|line| sources.contains(&line.source));
    of.map(|line| line.std_error[c].powi(2)).sum::<f64>().sqrt()
}

/// Standard error of a channel due to one source.
pub fn error_of(budget: &[Contribution], source: Source, c: usize) -> f64 {
    sum(budget, &[source], c)
}

/// Error of a slab's thickness as it affects the profile: that of the slab and that of the scale, since random walks
/// depend on ratios of lengths only.
pub(super) fn thickness_std_error_mm(sample: &CapturedSample, c: usize) -> f64 {
    let scale = sum(&sample.profile.budget, &[Source::Scale], c) * sample.about.thickness_mm;
    sample.about.thickness_std_error_mm.hypot(scale)
}
