//! Sums error budgets of single profiles, and the errors that all profiles of a session share.

use optics_capture::Source;
use serde::Serialize;

use super::captured::{Captured, CapturedSample};
use super::channels::CapturedChannel;

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
        let channels = captured.channels();
        let pooled = |sources: &[Source]| {
            let channel_squares = |channel: &CapturedChannel| {
                let square = |sample| channel.error(sample, sources).powi(2);
                channel.part.samples.iter().map(square).collect::<Vec<f64>>()
            };
            let squares: Vec<f64> = channels.iter().flat_map(channel_squares).collect();
            (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt().min(1.0)
        };
        Self {
            gain_std_error: pooled(&[Source::Drift, Source::Mounting, Source::Linearity]),
            offset_std_error: pooled(&[Source::Black, Source::Glare]),
            slope_std_error: pooled(&[Source::Slope]),
            origin_std_error_mm: pooled(&[Source::Origin]),
            mu_std_error: captured.parts[0].calibration.reference_std_error,
        }
    }
}

/// Error of a slab's thickness as it affects the profile: that of the slab and that of the scale, since random walks
/// depend on ratios of lengths only.
pub(super) fn thickness_std_error_mm(channel: &CapturedChannel, sample: &CapturedSample) -> f64 {
    let scale = channel.error(sample, &[Source::Scale]) * sample.about.thickness_mm;
    libm::hypot(sample.about.thickness_std_error_mm, scale)
}
