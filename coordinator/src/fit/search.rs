//! The exhaustive search, Eq. 1: for every channel the media that explain all its thicknesses best.

use farm_proto::fit::{Candidate, ChannelFit, FitOptions, ThicknessError};
use farm_proto::measurement::MIN_PIXELS;
use farm_proto::{Invalid, Measurement, Medium};
use rayon::prelude::*;

use super::dictionary::FitDictionary;
use super::distance::Target;
use super::resample::resample;

/// Two parameters are the same if they differ by less than this share: decimals in files are rounded.
const SAME: f64 = 1e-6;

/// Compares a measurement with every record and returns the best media per channel, best first; equal errors are in
/// the order of the records.
pub fn fit(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<Vec<ChannelFit>, Invalid> {
    let anisotropies = anisotropies(dictionary, options)?;
    measurement
        .channels()
        .into_iter()
        .map(|channel| {
            let question = ChannelQuestion::new(dictionary, measurement, channel, options)?;
            Ok(ChannelFit { channel: channel.to_owned(), candidates: question.best(&anisotropies) })
        })
        .collect()
}

/// Indices into the grid's g that the options admit.
fn anisotropies(dictionary: &FitDictionary, options: &FitOptions) -> Result<Vec<usize>, Invalid> {
    let axis = dictionary.grid().g();
    match options.g() {
        None => Ok((0..axis.len()).collect()),
        Some(g) => match find(axis, g) {
            Some(i) => Ok(vec![i]),
            None => Err(Invalid::new("g", g, format!("the dictionary has {}", list(axis)))),
        },
    }
}

fn find(axis: &[f64], value: f64) -> Option<usize> {
    axis.iter().position(|v| (v - value).abs() <= SAME * v.abs().max(1.0))
}

fn list(axis: &[f64]) -> String {
    axis.iter().map(f64::to_string).collect::<Vec<_>>().join(", ")
}

/// One thickness of one channel, ready to be compared.
struct Term {
    thickness: usize,
    target: Target,
}

struct ChannelQuestion<'a> {
    dictionary: &'a FitDictionary,
    channel: usize,
    terms: Vec<Term>,
    options: &'a FitOptions,
}

/// Indices of a medium into the axes of the grid.
#[derive(Clone, Copy)]
struct Place {
    ior: usize,
    sigma_t: usize,
    g: usize,
    albedo: usize,
}

impl<'a> ChannelQuestion<'a> {
    fn new(
        dictionary: &'a FitDictionary,
        measurement: &Measurement,
        channel: &str,
        options: &'a FitOptions,
    ) -> Result<Self, Invalid> {
        let scene = dictionary.grid().scene();
        let index = scene.channels().iter().position(|c| c.name() == channel).ok_or_else(|| {
            let names: Vec<_> = scene.channels().iter().map(farm_proto::scene::Channel::name).collect();
            Invalid::new("channel", channel, format!("the dictionary has {}", names.join(", ")))
        })?;
        let terms = measurement
            .profiles()
            .iter()
            .filter(|p| p.channel() == channel)
            .map(|profile| {
                let axis = dictionary.grid().thickness_mm();
                let thickness = find(axis, profile.thickness_mm()).ok_or_else(|| {
                    let allowed = format!("the dictionary has {}", list(axis));
                    Invalid::new("thickness_mm", profile.thickness_mm(), allowed)
                })?;
                let resampled = resample(profile, scene.sensor());
                if resampled.values.len() < MIN_PIXELS {
                    let (x, half) = (profile.x_mm(), scene.sensor().width_mm() / 2.0);
                    let given = format!("{} to {}", x[0], x[x.len() - 1]);
                    let allowed = format!(
                        "it covers {} pixels of the dictionary's {} to {half} mm, {MIN_PIXELS} are needed",
                        resampled.values.len(),
                        -half,
                    );
                    return Err(Invalid::new("x_mm", given, allowed));
                }
                let pitch = scene.sensor().pitch_mm();
                let target = Target::new(resampled.pixels, resampled.values, options.mu(), pitch);
                Ok(Term { thickness, target })
            })
            .collect::<Result<_, Invalid>>()?;
        Ok(Self { dictionary, channel: index, terms, options })
    }

    fn best(&self, anisotropies: &[usize]) -> Vec<Candidate> {
        let grid = self.dictionary.grid();
        let (iors, sigmas, albedos) =
            (grid.sample_ior().len(), grid.sigma_t_per_mm().len(), grid.albedo().len());
        let place = |n: usize| {
            let (rest, albedo) = (n / albedos, n % albedos);
            let (rest, g) = (rest / anisotropies.len(), rest % anisotropies.len());
            Place { ior: rest / sigmas, sigma_t: rest % sigmas, g: anisotropies[g], albedo }
        };
        let count = iors * sigmas * anisotropies.len() * albedos;
        let mut errors: Vec<(f64, usize)> = (0..count)
            .into_par_iter()
            .map_init(Vec::new, |scratch, n| (self.error(place(n), scratch), n))
            .collect();
        let by_error = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let top = self.options.top().min(count);
        if top < count {
            errors.select_nth_unstable_by(top, by_error);
            errors.truncate(top);
        }
        errors.sort_unstable_by(by_error);
        errors.into_iter().map(|(_, n)| self.candidate(place(n))).collect()
    }

    fn error(&self, place: Place, scratch: &mut Vec<f32>) -> f64 {
        let lambda = self.options.lambda();
        self.terms
            .iter()
            .map(|term| {
                let (value_rms, gradient_rms) = self.norms(term, self.record(term, place), scratch);
                value_rms + lambda * gradient_rms
            })
            .sum()
    }

    fn norms(&self, term: &Term, record: usize, scratch: &mut Vec<f32>) -> (f64, f64) {
        let pixels = term.target.pixels.clone();
        let values = self.dictionary.values(record, self.channel);
        if pixels.len() == values.len() {
            return term.target.norms(values, self.dictionary.gradient(record, self.channel));
        }
        self.dictionary.gradient_of_part(record, self.channel, pixels.clone(), scratch);
        term.target.norms(&values[pixels], scratch)
    }

    fn record(&self, term: &Term, place: Place) -> usize {
        let grid = self.dictionary.grid();
        grid.record_at(place.ior, place.sigma_t, place.g, term.thickness, place.albedo)
    }

    fn candidate(&self, place: Place) -> Candidate {
        let grid = self.dictionary.grid();
        let mut scratch = Vec::new();
        let thicknesses = self.terms.iter().map(|term| {
            let record = self.record(term, place);
            let (value_rms, gradient_rms) = self.norms(term, record, &mut scratch);
            let thickness_mm = grid.thickness_mm()[term.thickness];
            ThicknessError { thickness_mm, value_rms, gradient_rms, record }
        });
        let (sigma_t, albedo) = (grid.sigma_t_per_mm()[place.sigma_t], grid.albedo()[place.albedo]);
        Candidate {
            medium: Medium::new(sigma_t, albedo, grid.g()[place.g]).expect("axes hold checked values"),
            sample_ior: grid.sample_ior()[place.ior],
            thicknesses: thicknesses.collect(),
            error: self.error(place, &mut Vec::new()),
        }
    }
}

#[cfg(test)]
mod tests;
