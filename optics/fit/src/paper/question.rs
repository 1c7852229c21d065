//! Prepares one channel of a measurement for comparison with a dictionary.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use optics_model::fit::{Candidate, FitOptions, Outside, ThicknessError};
use optics_model::measurement::MIN_PIXELS;
use optics_model::{Invalid, MeasuredProfile, Measurement, Medium};

use crate::dictionary::FitDictionary;
use crate::dictionary::axes::{Admissible, SAME, find_channel, outside, unknown_thickness};
use crate::dictionary::sum::rms_difference;
use crate::dictionary::view::{PairDescription, View, ViewKey, made_once};
use crate::dictionary::wide::wide;
use crate::surrogate::resample::resample;

/// One thickness of one channel: μ F_A and |∇ μ F_A| on the pixels that the measurement covers.
#[derive(Debug)]
pub(crate) struct ComparedProfile {
    /// Index into the grid's thicknesses.
    pub thickness: usize,
    pub view: Arc<View>,
    pub values: Vec<f64>,
    pub gradient: Vec<f64>,
    description: OnceLock<PairDescription>,
}

impl ComparedProfile {
    fn new(
        (dictionary, channel): (&FitDictionary, usize),
        profile: &MeasuredProfile,
        options: &FitOptions,
    ) -> Result<Self, Invalid> {
        let axis = dictionary.grid().thickness_mm();
        let same = |v: &f64| (v - profile.thickness_mm()).abs() <= SAME * v.abs();
        let thickness = axis
            .iter()
            .position(same)
            .ok_or_else(|| unknown_thickness(dictionary.grid(), profile.thickness_mm()))?;
        let sensor = dictionary.grid().scene().sensor();
        let resampled = resample(profile.x_mm(), profile.values(), sensor);
        if resampled.values.len() < MIN_PIXELS {
            let (x, half) = (profile.x_mm(), sensor.width_mm() / 2.0);
            let given = format!("{} to {}", x[0], x[x.len() - 1]);
            let allowed = format!(
                "it covers {} pixels of the dictionary's {} to {half} mm, {MIN_PIXELS} are needed",
                resampled.values.len(),
                -half,
            );
            return Err(Invalid::new("x_mm", given, allowed));
        }
        let settings = options.settings();
        let key =
            ViewKey { pixels: resampled.pixels.clone(), wavelet: settings.wavelet, level: settings.level };
        let view = dictionary.view(channel, &key);
        let values: Vec<f64> = resampled.values.iter().map(|v| settings.mu * v).collect();
        let gradient = view.slope().magnitude(&values);
        let description = OnceLock::new();
        Ok(Self { thickness, view, values, gradient, description })
    }

    /// The profile in the bases of the view, which searches compare with the view's sketches.
    pub(crate) fn description(&self) -> &PairDescription {
        made_once(&self.description, || self.view.describe(&self.values, &self.gradient))
    }

    /// The description of the profile multiplied by a factor.
    pub(crate) fn described_at(&self, factor: f64) -> PairDescription {
        let scaled = |f: &[f64]| f.iter().map(|v| factor * v).collect::<Vec<f64>>();
        self.view.describe(&scaled(&self.values), &scaled(&self.gradient))
    }
}

/// Indices of a medium into the axes of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct GridPlace {
    pub ior: usize,
    pub sigma_t: usize,
    pub g: usize,
    pub albedo: usize,
}

#[derive(Debug)]
pub(crate) struct Question<'a> {
    pub dictionary: &'a FitDictionary,
    pub name: &'a str,
    /// Index into the scene's channels.
    pub channel: usize,
    pub terms: Vec<ComparedProfile>,
    pub options: FitOptions,
    pub admissible: Admissible,
}

/// Maximum number of ranges of pixels that one request may compare: each needs descriptions of all records, some 150 MB
/// for the paper's dictionary.
const RANGES: usize = 4;

/// Refuses profiles that cover too many different ranges of the dictionary's pixels.
pub(crate) fn check_ranges<'a>(
    dictionary: &FitDictionary,
    materials: impl IntoIterator<Item = &'a Measurement>,
) -> Result<(), Invalid> {
    let sensor = dictionary.grid().scene().sensor();
    let profiles = materials.into_iter().flat_map(Measurement::profiles);
    let mut ranges: Vec<(usize, usize)> = profiles
        .map(|p| resample(p.x_mm(), p.values(), sensor).pixels)
        .map(|pixels| (pixels.start, pixels.end))
        .collect();
    ranges.sort_unstable();
    ranges.dedup();
    if ranges.len() > RANGES {
        let given = format!("{} different ranges of the dictionary's pixels", ranges.len());
        let allowed =
            format!("at most {RANGES} in one request are allowed: cut the profiles to the same range");
        return Err(Invalid::new("x_mm", given, allowed));
    }
    Ok(())
}

/// One question per channel of a measurement.
pub(crate) fn questions<'a>(
    dictionary: &'a FitDictionary,
    measurement: &'a Measurement,
    options: &FitOptions,
) -> Result<Vec<Question<'a>>, Invalid> {
    check_ranges(dictionary, [measurement])?;
    let admissible = Admissible::new(dictionary, options)?;
    let question = |name| Question::new(dictionary, measurement, name, options, admissible.clone());
    measurement.channels().into_iter().map(question).collect()
}

impl<'a> Question<'a> {
    pub(crate) fn new(
        dictionary: &'a FitDictionary,
        measurement: &'a Measurement,
        name: &'a str,
        options: &FitOptions,
        admissible: Admissible,
    ) -> Result<Self, Invalid> {
        let channel = find_channel(dictionary.grid(), name)?;
        let profiles = measurement.profiles().iter().filter(|p| p.channel() == name);
        let term = |profile| ComparedProfile::new((dictionary, channel), profile, options);
        let terms = profiles.map(term).collect::<Result<_, _>>()?;
        Ok(Self { dictionary, name, channel, terms, options: *options, admissible })
    }

    /// Number of the medium over all axes, in the order of its records.
    pub(crate) fn medium_number(&self, place: GridPlace) -> usize {
        let grid = self.dictionary.grid();
        let row = (place.ior * grid.sigma_t_per_mm().len() + place.sigma_t) * grid.g().len() + place.g;
        row * grid.albedo().len() + place.albedo
    }

    pub(crate) fn place(&self, medium: usize) -> GridPlace {
        let grid = self.dictionary.grid();
        let (rest, albedo) = (medium / grid.albedo().len(), medium % grid.albedo().len());
        let (rest, g) = (rest / grid.g().len(), rest % grid.g().len());
        let (ior, sigma_t) = (rest / grid.sigma_t_per_mm().len(), rest % grid.sigma_t_per_mm().len());
        GridPlace { ior, sigma_t, g, albedo }
    }

    /// The admissible media of a range of anisotropies, as ranges of medium numbers in ascending order.
    pub(crate) fn media(&self, g: &Range<usize>) -> Vec<Range<usize>> {
        let grid = self.dictionary.grid();
        let Admissible { sigma_t, albedo, .. } = &self.admissible;
        let mut ranges: Vec<Range<usize>> = Vec::new();
        for ior in 0..grid.sample_ior().len() {
            for sigma_t in sigma_t.clone() {
                for g in g.clone() {
                    let first = self.medium_number(GridPlace { ior, sigma_t, g, albedo: albedo.start });
                    let end = first + albedo.len();
                    match ranges.last_mut() {
                        Some(last) if last.end == first => last.end = end,
                        _ => ranges.push(first..end),
                    }
                }
            }
        }
        ranges
    }

    pub(crate) fn record(&self, term: &ComparedProfile, place: GridPlace) -> usize {
        self.dictionary.stop.check();
        let grid = self.dictionary.grid();
        grid.record_at(place.ior, place.sigma_t, place.g, term.thickness, place.albedo)
    }

    /// The two norms of Eq. 2: of the values' difference and of the gradients'.
    fn norms(&self, term: &ComparedProfile, place: GridPlace) -> (f64, f64) {
        let (values, gradient) = term.view.profile(self.record(term, place));
        wide(
            #[inline(always)]
            || (rms_difference(&term.values, &values), rms_difference(&term.gradient, &gradient)),
        )
    }

    /// The sum of Eq. 1.
    pub(crate) fn error(&self, place: GridPlace) -> f64 {
        let lambda = self.options.settings().lambda;
        self.terms
            .iter()
            .map(|term| {
                let (value_rms, gradient_rms) = self.norms(term, place);
                value_rms + lambda * gradient_rms
            })
            .sum()
    }

    pub(crate) fn candidate(&self, place: GridPlace) -> Candidate {
        let grid = self.dictionary.grid();
        let thicknesses = self.terms.iter().map(|term| {
            let (value_rms, gradient_rms) = self.norms(term, place);
            let thickness_mm = grid.thickness_mm()[term.thickness];
            ThicknessError { thickness_mm, value_rms, gradient_rms, record: Some(self.record(term, place)) }
        });
        let (sigma_t, albedo) = (grid.sigma_t_per_mm()[place.sigma_t], grid.albedo()[place.albedo]);
        Candidate {
            medium: Medium::new(sigma_t, albedo, grid.g()[place.g]).expect("axes hold checked values"),
            sample_ior: grid.sample_ior()[place.ior],
            thicknesses: thicknesses.collect(),
            error: self.error(place),
        }
    }

    /// Whether a profile is brighter or darker than all records, in the mean.
    pub(crate) fn outside(&self) -> Option<Outside> {
        self.terms.iter().find_map(|term| {
            let mean = term.values.iter().sum::<f64>() / term.values.len() as f64;
            outside(mean, term.view.value_sketch(term.thickness).levels)
        })
    }
}
