//! The channels of a session in one form: red, green and blue, or one for each band.

use optics_capture::{BoardRho, Calibration, EdgeProfile, EdgeSfr, Estimate, Source};

use super::bands::Band;
use super::captured::{Captured, CapturedPart, CapturedSample};

/// A channel of measurements, and its column in the results of its part.
#[derive(Debug, Clone)]
pub struct CapturedChannel<'a> {
    pub name: String,
    pub part: &'a CapturedPart,
    pub column: usize,
}

impl Captured {
    /// All channels, in the order of the parts.
    pub fn channels(&self) -> Vec<CapturedChannel<'_>> {
        self.parts.iter().flat_map(CapturedPart::channels).collect()
    }
}

/// Every channel of every sample, sample by sample.
pub fn profiles<'a, 'b>(
    channels: &'a [CapturedChannel<'b>],
) -> impl Iterator<Item = (&'a CapturedChannel<'b>, &'b CapturedSample)> {
    let samples = channels.first().map_or(0, |channel| channel.part.samples.len());
    let pairs = move |i: usize| channels.iter().map(move |channel| (channel, &channel.part.samples[i]));
    (0..samples).flat_map(pairs)
}

impl CapturedPart {
    pub fn channels(&self) -> Vec<CapturedChannel<'_>> {
        let names = channel_names(self.band.as_ref(), &self.calibration).into_iter();
        names.enumerate().map(|(column, name)| CapturedChannel { name, part: self, column }).collect()
    }
}

/// The channels of a part in measurements: the wavelength of a band, or the colours of the camera.
pub(super) fn channel_names(band: Option<&Band>, calibration: &Calibration) -> Vec<String> {
    let colours = calibration.columns().iter();
    colours.map(|colour| band.map_or_else(|| colour.letter().to_owned(), Band::channel)).collect()
}

impl<'a> CapturedChannel<'a> {
    pub fn profile(&self, sample: &'a CapturedSample) -> &'a EdgeProfile {
        &sample.profile.profiles[self.column]
    }

    pub fn bare_profile(&self) -> &'a EdgeProfile {
        &self.part.board.profiles[self.column]
    }

    /// Standard deviation of the camera's blur in mm.
    pub fn blur_mm(&self) -> Estimate {
        self.part.board.blur_mm[self.column]
    }

    /// Response of the camera to spatial frequencies.
    pub fn sfr(&self) -> Option<&'a EdgeSfr> {
        self.part.board.sfr[self.column].as_ref()
    }

    pub fn rho(&self) -> BoardRho {
        self.part.rho[self.column]
    }

    /// Standard error of a profile's source, or of several independent ones.
    pub fn error(&self, sample: &CapturedSample, sources: &[Source]) -> f64 {
        let lines = sample.profile.budget.iter().filter(|line| sources.contains(&line.source));
        lines.map(|line| line.std_error[self.column].powi(2)).sum::<f64>().sqrt()
    }
}

/// Radiance factors at both ends of a profile: the means of a tenth of it.
pub fn ends(profile: &EdgeProfile) -> [f64; 2] {
    let n = profile.values.len();
    let tenth = n.div_ceil(10).min(n);
    [mean(&profile.values[..tenth]), mean(&profile.values[n - tenth..])]
}

pub fn mean(values: &[f64]) -> f64 {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    finite.iter().sum::<f64>() / finite.len().max(1) as f64
}
