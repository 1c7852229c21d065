//! The report of each shot.

use crate::bins::{Binning, EdgeProfile};
use crate::estimate::Estimate;
use crate::light_field::LightChange;

/// One shot of a bare board or of a sample.
#[derive(Debug, Clone)]
pub struct ShotReport {
    pub label: String,
    /// Pixels of samples in the crop that were rejected as dust or scratches.
    pub rejected_px: Vec<[u32; 2]>,
    /// Movement since the first bare shot, sideways and up and down, where it could be measured.
    pub moved_px: [Option<Estimate>; 2],
    /// Light of the free board relative to the bare shots, per channel, where it could be measured.
    pub light: Option<Vec<LightChange>>,
    /// σ of lens and pixel, where a bare edge shows it.
    pub blur_px: Option<Estimate>,
    /// Ratio of the scatter of samples within bins to the sensor's noise, per channel.
    pub scatter: Vec<f64>,
    /// Profiles of this shot alone.
    pub profiles: Vec<EdgeProfile>,
}

impl ShotReport {
    pub(crate) fn new(
        label: &str,
        moved_px: [Option<Estimate>; 2],
        light: Option<Vec<LightChange>>,
        blur_px: Option<Estimate>,
        binnings: Vec<Binning>,
    ) -> Self {
        let scatter = binnings.iter().map(|b| b.scatter).collect();
        let mut rejected_px: Vec<[u32; 2]> = binnings.iter().flat_map(|b| b.rejected_px.clone()).collect();
        rejected_px.sort_unstable();
        let profiles = binnings.into_iter().map(|b| b.profile).collect();
        Self { label: label.to_owned(), rejected_px, moved_px, light, blur_px, scatter, profiles }
    }

    /// Share of the crop's samples that were rejected.
    pub fn rejected_share(&self) -> f64 {
        let total: u32 = self.profiles.iter().flat_map(|p| &p.counts).sum();
        self.rejected_px.len() as f64 / f64::from(total.max(1))
    }
}
