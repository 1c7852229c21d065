//! Determines black level and fixed pattern of the sensor, from dark shots or from the levels in a file.

use crate::camera_settings::CameraSettings;
use crate::estimate::Estimate;
use crate::frame::{Frame, Pattern, Photo, Site};
use crate::least_squares::robust_mean;
use crate::noise::Pairs;
use crate::refusal::{Refusal, Warning};
use crate::saturation::Saturation;

/// Share of zeros in a dark shot above which its noise counts as cut off, in percent.
const ZEROS_PERCENT: f64 = 2.0;

/// Accumulates dark shots.
#[derive(Debug, Default, Clone)]
pub struct Darks {
    last: Option<Photo>,
    sum: Vec<u32>,
    means: Vec<Vec<f64>>,
    covariances: Vec<Vec<f64>>,
    pairs: Pairs,
}

/// The sensor's output without light.
#[derive(Debug, Clone)]
pub struct Black {
    levels: Vec<Estimate>,
    fixed_pattern: Vec<f64>,
    /// Deviation of each sample from its site's level.
    map: Option<Vec<f32>>,
    pub(crate) pairs: Pairs,
    pub(crate) warnings: Vec<Warning>,
}

impl Darks {
    pub fn new() -> Self {
        Self::default()
    }

    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        if let Some(last) = &self.last {
            CameraSettings::of(last).check(&photo)?;
        }
        let samples = photo.frame.samples();
        let share = zeros_percent(&photo);
        if share > ZEROS_PERCENT && photo.frame.pattern() != Pattern::Rgb {
            return Err(Refusal::BlackSubtracted { label: photo.label, share });
        }
        self.sum.resize(samples.len(), 0);
        for (sum, s) in self.sum.iter_mut().zip(samples) {
            *sum += u32::from(*s);
        }
        let sites = photo.frame.sites();
        self.means.push(sites.iter().map(|s| site_mean(&photo.frame, *s)).collect());
        if let Some(last) = self.last.take() {
            let levels: Vec<_> = self.means[0].iter().map(|m| Estimate::new(*m, 0.0)).collect();
            self.pairs.add(&last.frame, &photo.frame, &levels, Saturation::all(f64::INFINITY));
            self.covariances.push(sites.iter().map(|s| covariance(&last.frame, &photo.frame, *s)).collect());
        }
        self.last = Some(photo);
        Ok(())
    }

    /// Without dark shots, the level is taken from the file of `any` photograph of the session.
    pub fn finish(self, any: &Photo) -> Result<Black, Refusal> {
        let Some(last) = &self.last else { return Black::from_file(any) };
        CameraSettings::of(last).check(any)?;
        let sites = last.frame.sites();
        let site_values = |lists: &[Vec<f64>], s: usize| lists.iter().map(|l| l[s]).collect::<Vec<_>>();
        let mut levels = Vec::new();
        let mut fixed_pattern = Vec::new();
        for site in &sites {
            levels.push(mean_of(&site_values(&self.means, site.index)));
            let covariance = mean_of(&site_values(&self.covariances, site.index)).value;
            fixed_pattern.push(if covariance.is_finite() { covariance.max(0.0).sqrt() } else { 0.0 });
        }
        let noise = self.pairs_read(&sites);
        let map = self.map(&last.frame, &levels, &fixed_pattern, &noise);
        Ok(Black { levels, fixed_pattern, map, pairs: self.pairs, warnings: Vec::new() })
    }

    /// Variance of one dark sample about its own mean.
    fn pairs_read(&self, sites: &[Site]) -> Vec<f64> {
        sites.iter().map(|site| self.pairs.dark_variance(site.index)).collect()
    }

    /// The mean of the dark shots, shrunk by the fixed pattern's share of its variance, f²/(f² + σ²/n). Otherwise the
    /// noise of this map would be added to all photographs.
    fn map(&self, frame: &Frame, levels: &[Estimate], fixed: &[f64], noise: &[f64]) -> Option<Vec<f32>> {
        let shots = self.means.len() as f64;
        let share = |s: usize| fixed[s].powi(2) / (fixed[s].powi(2) + noise[s] / shots).max(1e-9);
        let shares: Vec<f64> = (0..fixed.len()).map(share).collect();
        if shares.iter().all(|s| *s < 0.05) {
            return None;
        }
        let mut map = vec![0.0_f32; self.sum.len()];
        for site in frame.sites() {
            for_each(frame, site, 1, |index| {
                let departure = f64::from(self.sum[index]) / shots - levels[site.index].value;
                map[index] = (shares[site.index] * departure) as f32;
            });
        }
        Some(map)
    }
}

impl Black {
    /// Black level of each site.
    pub fn levels(&self) -> &[Estimate] {
        &self.levels
    }

    /// The largest standard error of a site's level, in numbers.
    pub(crate) fn std_error(&self) -> f64 {
        self.levels.iter().map(|level| level.std_error).fold(0.0, f64::max)
    }

    /// Standard deviation of the fixed pattern of each site, in numbers; 0 if none was found.
    pub fn fixed_pattern(&self) -> &[f64] {
        &self.fixed_pattern
    }

    /// The black level in a photograph's file.
    pub(crate) fn from_file(photo: &Photo) -> Result<Self, Refusal> {
        let Some(levels) = photo.levels.black else {
            return Err(Refusal::BlackUnknown { label: photo.label.clone() });
        };
        let sites = photo.frame.sites();
        let mut warnings = vec![Warning::NoDark];
        if sites.iter().all(|site| levels[site.position] == 0.0) {
            if photo.frame.pattern() != Pattern::Rgb {
                let (label, share) = (photo.label.clone(), zeros_percent(photo));
                // A level of 0 in a file whose samples do not show it is no level.
                let is_cut = share > ZEROS_PERCENT;
                return Err(if is_cut {
                    Refusal::BlackSubtracted { label, share }
                } else {
                    Refusal::BlackUnknown { label }
                });
            }
            warnings.push(Warning::BlackSubtracted);
        }
        Ok(Self {
            levels: sites.iter().map(|s| Estimate::new(levels[s.position], 1.0)).collect(),
            fixed_pattern: vec![0.0; sites.len()],
            map: None,
            pairs: Pairs::default(),
            warnings,
        })
    }

    /// Number of a sample above black.
    pub(crate) fn signal(&self, frame: &Frame, site: Site, x: usize, y: usize) -> f64 {
        let departure = self.map.as_ref().map_or(0.0, |map| f64::from(map[index(frame, site, x, y)]));
        f64::from(frame.at(site, x, y)) - self.levels[site.index].value - departure
    }
}

/// Share of the samples that are 0, in percent.
fn zeros_percent(photo: &Photo) -> f64 {
    let samples = photo.frame.samples();
    100.0 * samples.iter().filter(|s| **s == 0).count() as f64 / samples.len() as f64
}

fn index(frame: &Frame, site: Site, x: usize, y: usize) -> usize {
    match frame.pattern() {
        Pattern::Bayer(_) | Pattern::One(_) => y * frame.width() + x,
        Pattern::Rgb => (y * frame.width() + x) * 3 + site.index,
    }
}

/// Visits the samples of a site, in every `skip`th row.
fn for_each(frame: &Frame, site: Site, skip: usize, mut f: impl FnMut(usize)) {
    for y in (site.row..frame.height()).step_by(site.step * skip) {
        for x in (site.column..frame.width()).step_by(site.step) {
            f(index(frame, site, x, y));
        }
    }
}

/// Step between rows where a share of the samples suffices, for a level to 0.003 numbers.
fn skip(frame: &Frame) -> usize {
    (frame.samples().len() / 4_000_000).max(1)
}

fn site_mean(frame: &Frame, site: Site) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for_each(frame, site, skip(frame), |i| {
        sum += f64::from(frame.samples()[i]);
        count += 1.0;
    });
    sum / count
}

/// Covariance of two dark shots over their samples: the variance of the pattern that they share, without hot pixels.
fn covariance(a: &Frame, b: &Frame, site: Site) -> f64 {
    let (of_a, of_b) = (site_mean(a, site), site_mean(b, site));
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    let mut limit = f64::INFINITY;
    for _ in 0..2 {
        (sum, squares, count) = (0.0, 0.0, 0.0);
        for_each(a, site, skip(a), |i| {
            let (x, y) = (f64::from(a.samples()[i]) - of_a, f64::from(b.samples()[i]) - of_b);
            if x.abs() < limit && y.abs() < limit {
                sum += x * y;
                squares += f64::midpoint(x * x, y * y);
                count += 1.0;
            }
        });
        limit = 6.0 * (squares / f64::max(count, 1.0)).sqrt();
    }
    let (covariance, variance) = (sum / f64::max(count, 1.0), squares / f64::max(count, 1.0));
    // Independent samples have a covariance of about σ²/√n by chance.
    if covariance > 4.0 * variance / f64::max(count, 1.0).sqrt() { covariance } else { 0.0 }
}

fn mean_of(values: &[f64]) -> Estimate {
    match values {
        [] => Estimate::new(f64::NAN, f64::NAN),
        // The readout offset differs by a fraction of a number from shot to shot.
        [one] => Estimate::new(*one, 0.5),
        several => {
            let (mean, _) = robust_mean(several);
            let n = several.len() as f64;
            let variance = several.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
            Estimate::new(mean, (variance / n).sqrt())
        }
    }
}
