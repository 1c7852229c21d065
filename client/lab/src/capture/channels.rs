//! The channels of a session in one form: red, green and blue, or one for each band.
//!
//! The photographs of a band have three interleaved parts, each with its own results. Their profiles are joined; errors
//! that they share, such as that of the light, are averaged, and independent ones shrink.

use optics_capture::{BoardRho, EdgeProfile, EdgeSfr, Estimate, Source, join_parts};
use optics_capture::{Colour, Contribution};

use super::captured::{Captured, CapturedPart, CapturedSample};

/// A channel of measurements, and the columns of a part's results that it has.
#[derive(Debug, Clone)]
pub struct CapturedChannel<'a> {
    pub name: String,
    pub part: &'a CapturedPart,
    columns: &'static [usize],
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
        match &self.band {
            Some(band) => vec![CapturedChannel { name: band.channel(), part: self, columns: &[0, 1, 2] }],
            None => Colour::ALL
                .map(|colour| CapturedChannel {
                    name: colour.letter().to_owned(),
                    part: self,
                    columns: match colour {
                        Colour::Red => &[0],
                        Colour::Green => &[1],
                        Colour::Blue => &[2],
                    },
                })
                .to_vec(),
        }
    }
}

impl CapturedChannel<'_> {
    pub fn profile(&self, sample: &CapturedSample) -> EdgeProfile {
        self.joined(&sample.profile.profiles)
    }

    pub fn bare_profile(&self) -> EdgeProfile {
        self.joined(&self.part.board.profiles)
    }

    fn joined(&self, profiles: &[EdgeProfile; 3]) -> EdgeProfile {
        match self.columns {
            [c] => profiles[*c].clone(),
            _ => join_parts(profiles),
        }
    }

    /// Standard deviation of the camera's blur in mm.
    pub fn blur_mm(&self) -> Estimate {
        self.independent(&self.part.board.blur_mm)
    }

    /// Response of the camera to spatial frequencies: of several columns that of the first.
    pub fn sfr(&self) -> Option<&EdgeSfr> {
        self.part.board.sfr[self.columns[0]].as_ref()
    }

    pub fn rho(&self) -> BoardRho {
        let rho = &self.part.rho;
        let side = |of: &dyn Fn(&BoardRho) -> Estimate| self.shared(&rho.each_ref().map(of));
        let darker = [0, 1].map(|side| self.mean(|c| rho[c].under_darker_white[side]));
        BoardRho { light: side(&|r| r.light), dark: side(&|r| r.dark), under_darker_white: darker }
    }

    /// Standard error of a profile's source, or of several independent ones.
    pub fn error(&self, sample: &CapturedSample, sources: &[Source]) -> f64 {
        let lines = sample.profile.budget.iter().filter(|line| sources.contains(&line.source));
        lines.map(|line| self.of_line(sample, line).powi(2)).sum::<f64>().sqrt()
    }

    fn of_line(&self, sample: &CapturedSample, line: &Contribution) -> f64 {
        match (line.source, self.columns) {
            (Source::Noise, [_, ..]) if self.columns.len() > 1 => mean(&self.profile(sample).std_errors),
            _ => self.mean(|c| line.std_error[c].powi(2)).sqrt(),
        }
    }

    /// The mean of estimates whose errors are common to the columns.
    pub fn shared(&self, of: &[Estimate; 3]) -> Estimate {
        Estimate::new(self.mean(|c| of[c].value), self.mean(|c| of[c].std_error.powi(2)).sqrt())
    }

    /// The mean of estimates with independent errors, weighted by these.
    fn independent(&self, of: &[Estimate; 3]) -> Estimate {
        let weight = |c: usize| of[c].std_error.powi(-2);
        let whole: f64 = self.columns.iter().map(|c| weight(*c)).sum();
        match self.columns {
            [c] => of[*c],
            _ if !whole.is_finite() || whole <= 0.0 => self.shared(of),
            columns => {
                let sum: f64 = columns.iter().map(|c| weight(*c) * of[*c].value).sum();
                Estimate::new(sum / whole, whole.sqrt().recip())
            }
        }
    }

    /// The mean over the columns.
    pub fn mean(&self, of: impl Fn(usize) -> f64) -> f64 {
        self.columns.iter().map(|c| of(*c)).sum::<f64>() / self.columns.len() as f64
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
