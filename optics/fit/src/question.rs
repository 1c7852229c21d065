//! One channel of a measurement, made ready to be compared with a dictionary.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use optics_model::fit::{Bounds, Candidate, FitOptions, Outside, ThicknessError};
use optics_model::measurement::{MIN_PIXELS, colour};
use optics_model::scene::Channel;
use optics_model::{Grid, Invalid, MeasuredProfile, Measurement, Medium};

use super::dictionary::FitDictionary;
use super::resample::{Resampled, resample};
use super::sum::rms_difference;
use super::view::{PairDescription, View, ViewKey, made_once};
use super::wide::wide;

/// Two parameters are the same if they differ by less than this share: decimals in files are rounded.
const SAME: f64 = 1e-6;

/// Share by which a profile's mean must exceed all records' to be called outside: more than noise does.
pub(super) const OUTSIDE: f64 = 0.01;

/// Media that a search looks at, as ranges of the grid's axes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Admissible {
    pub sigma_t: Range<usize>,
    pub g: Range<usize>,
    pub albedo: Range<usize>,
}

impl Admissible {
    pub(super) fn new(dictionary: &FitDictionary, options: &FitOptions) -> Result<Self, Invalid> {
        let (grid, settings) = (dictionary.grid(), options.settings());
        Ok(Self {
            sigma_t: within("sigma_t_per_mm", grid.sigma_t_per_mm(), settings.sigma_t_per_mm)?,
            g: within("g", grid.g(), settings.g)?,
            albedo: within("albedo", grid.albedo(), settings.albedo)?,
        })
    }
}

/// Nodes within the bounds; if the bounds lie between two nodes, these two.
fn within(field: &str, axis: &[f64], bounds: Bounds) -> Result<Range<usize>, Invalid> {
    let slack = |v: f64| if v.is_finite() { SAME * v.abs().max(1e-3) } else { 0.0 };
    let (min, max) = (bounds.min() - slack(bounds.min()), bounds.max() + slack(bounds.max()));
    let first = axis.partition_point(|v| *v < min);
    let end = axis.partition_point(|v| *v <= max);
    if first < end {
        return Ok(first..end);
    }
    if first == 0 || first == axis.len() {
        let given = if bounds.is_fixed() {
            bounds.min().to_string()
        } else {
            format!("{} to {}", bounds.min(), bounds.max())
        };
        let allowed = format!("the dictionary has {}", span(axis));
        return Err(Invalid::new(field, given, allowed));
    }
    Ok(first - 1..first + 1)
}

fn span(axis: &[f64]) -> String {
    match axis {
        [one] => format!("{one} alone"),
        [first, .., last] => format!("{first} to {last}"),
        [] => "none".to_owned(),
    }
}

pub(super) fn list(axis: &[f64]) -> String {
    axis.iter().map(f64::to_string).collect::<Vec<_>>().join(", ")
}

/// The refusal of a thickness that the dictionary does not have, with what to submit.
pub(super) fn unknown_thickness(grid: &Grid, thickness_mm: f64) -> Invalid {
    let axis = grid.thickness_mm();
    let mut wanted = [axis, &[thickness_mm]].concat();
    wanted.sort_by(f64::total_cmp);
    let allowed = format!(
        "the dictionary has {}; `farmctl submit GRID.toml` computes one with all of them if the grid file says \
         thickness_mm = [{}], and takes over what is there. With --objective likelihood, thicknesses near the dictionary's \
         need none",
        list(axis),
        list(&wanted)
    );
    Invalid::new("thickness_mm", thickness_mm, allowed)
}

/// Index of a channel among the scene's.
pub(super) fn find_channel(grid: &Grid, name: &str) -> Result<usize, Invalid> {
    let channels = grid.scene().channels();
    let called = |c: &Channel| c.name() == name;
    // A colour may have another spelling here than in the measurement.
    let alike = |c: &Channel| colour(name).is_some() && colour(c.name()) == colour(name);
    let found = channels.iter().position(called).or_else(|| channels.iter().position(alike));
    found.ok_or_else(|| {
        let names: Vec<_> = channels.iter().map(Channel::name).collect();
        Invalid::new("channel", name, format!("the dictionary has {}", names.join(", ")))
    })
}

/// Indices of the channels that a question about these names needs, rising; of the first if there are none. Names that a
/// grid does not have are left out: the question itself refuses them.
pub fn channels_called<'a>(grid: &Grid, names: impl IntoIterator<Item = &'a str>) -> Vec<usize> {
    let mut names = names.into_iter().peekable();
    let mut indices = match names.peek() {
        None => vec![0],
        Some(_) => names.filter_map(|name| find_channel(grid, name).ok()).collect(),
    };
    let darker: Vec<usize> = indices.iter().filter_map(|i| grid.scene().under_darker_white(*i)).collect();
    indices.extend(darker);
    indices.sort_unstable();
    indices.dedup();
    indices
}

/// One thickness of one channel: μ F_A and |∇ μ F_A| on the pixels that the measurement covers.
#[derive(Debug)]
pub(super) struct Term<'a> {
    pub profile: &'a MeasuredProfile,
    pub resampled: Resampled,
    /// Index into the grid's thicknesses.
    pub thickness: usize,
    pub view: Arc<View>,
    pub values: Vec<f64>,
    pub gradient: Vec<f64>,
    description: OnceLock<PairDescription>,
}

impl<'a> Term<'a> {
    fn new(
        (dictionary, channel): (&FitDictionary, usize),
        profile: &'a MeasuredProfile,
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
        Ok(Self { profile, resampled, thickness, view, values, gradient, description })
    }

    /// The same with other values.
    fn changed(&self, change: impl Fn(&[f64]) -> Vec<f64>) -> Self {
        let values = change(&self.values);
        let gradient = self.view.slope().magnitude(&values);
        let (resampled, view, description) = (self.resampled.clone(), self.view.clone(), OnceLock::new());
        Self { resampled, view, values, gradient, description, ..*self }
    }

    /// What searches hold against the view's sketches.
    pub(super) fn description(&self) -> &PairDescription {
        made_once(&self.description, || self.view.describe(&self.values, &self.gradient))
    }
}

/// Indices of a medium into the axes of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    pub ior: usize,
    pub sigma_t: usize,
    pub g: usize,
    pub albedo: usize,
}

#[derive(Debug)]
pub(super) struct Question<'a> {
    pub dictionary: &'a FitDictionary,
    pub name: &'a str,
    /// Index into the scene's channels.
    pub channel: usize,
    pub terms: Vec<Term<'a>>,
    pub options: FitOptions,
    pub admissible: Admissible,
}

/// Most ranges of pixels that one request may compare: each takes a description of all records, some 150 MB for the
/// paper's dictionary.
const RANGES: usize = 4;

/// Refuses profiles that cover too many different ranges of the dictionary's pixels.
pub(super) fn check_ranges<'a>(
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
pub(super) fn questions<'a>(
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
    pub(super) fn new(
        dictionary: &'a FitDictionary,
        measurement: &'a Measurement,
        name: &'a str,
        options: &FitOptions,
        admissible: Admissible,
    ) -> Result<Self, Invalid> {
        let channel = find_channel(dictionary.grid(), name)?;
        let profiles = measurement.profiles().iter().filter(|p| p.channel() == name);
        let term = |profile| Term::new((dictionary, channel), profile, options);
        let terms = profiles.map(term).collect::<Result<_, _>>()?;
        Ok(Self { dictionary, name, channel, terms, options: *options, admissible })
    }

    /// The same with other values of all profiles; what they were measured as, and the options, stay as they are.
    pub(super) fn changed(&self, change: impl Fn(&[f64]) -> Vec<f64>) -> Self {
        let terms = self.terms.iter().map(|t| t.changed(&change)).collect();
        Self { terms, admissible: self.admissible.clone(), ..*self }
    }

    /// The same with each profile at the thickness of the one on the other side of the list.
    pub(super) fn swapped(&self) -> Self {
        let other = |(t, thickness): (&Term<'a>, usize)| Term { thickness, ..t.changed(<[f64]>::to_vec) };
        let thicknesses = self.terms.iter().rev().map(|t| t.thickness);
        let terms = self.terms.iter().zip(thicknesses).map(other).collect();
        Self { terms, admissible: self.admissible.clone(), ..*self }
    }

    /// Number of the medium over all axes, in the order of its records.
    pub(super) fn medium_number(&self, place: Place) -> usize {
        let grid = self.dictionary.grid();
        let row = (place.ior * grid.sigma_t_per_mm().len() + place.sigma_t) * grid.g().len() + place.g;
        row * grid.albedo().len() + place.albedo
    }

    pub(super) fn place(&self, medium: usize) -> Place {
        let grid = self.dictionary.grid();
        let (rest, albedo) = (medium / grid.albedo().len(), medium % grid.albedo().len());
        let (rest, g) = (rest / grid.g().len(), rest % grid.g().len());
        let (ior, sigma_t) = (rest / grid.sigma_t_per_mm().len(), rest % grid.sigma_t_per_mm().len());
        Place { ior, sigma_t, g, albedo }
    }

    /// The admissible media of a range of anisotropies, as ranges of medium numbers, rising.
    pub(super) fn media(&self, g: &Range<usize>) -> Vec<Range<usize>> {
        let grid = self.dictionary.grid();
        let Admissible { sigma_t, albedo, .. } = &self.admissible;
        let mut ranges: Vec<Range<usize>> = Vec::new();
        for ior in 0..grid.sample_ior().len() {
            for sigma_t in sigma_t.clone() {
                for g in g.clone() {
                    let first = self.medium_number(Place { ior, sigma_t, g, albedo: albedo.start });
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

    pub(super) fn record(&self, term: &Term, place: Place) -> usize {
        self.dictionary.stop.check();
        let grid = self.dictionary.grid();
        grid.record_at(place.ior, place.sigma_t, place.g, term.thickness, place.albedo)
    }

    /// The two norms of Eq. 2: of the values' difference and of the gradients'.
    fn norms(&self, term: &Term, place: Place) -> (f64, f64) {
        let (values, gradient) = term.view.profile(self.record(term, place));
        wide(
            #[inline(always)]
            || (rms_difference(&term.values, &values), rms_difference(&term.gradient, &gradient)),
        )
    }

    /// The sum of Eq. 1.
    pub(super) fn error(&self, place: Place) -> f64 {
        let lambda = self.options.settings().lambda;
        self.terms
            .iter()
            .map(|term| {
                let (value_rms, gradient_rms) = self.norms(term, place);
                value_rms + lambda * gradient_rms
            })
            .sum()
    }

    pub(super) fn candidate(&self, place: Place) -> Candidate {
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
    pub(super) fn outside(&self) -> Option<Outside> {
        self.terms.iter().find_map(|term| {
            let mean = term.values.iter().sum::<f64>() / term.values.len() as f64;
            let (least, greatest) = term.view.value_sketch(term.thickness).levels;
            if mean > greatest * (1.0 + OUTSIDE) {
                Some(Outside::Brighter)
            } else if mean < least * (1.0 - OUTSIDE) {
                Some(Outside::Darker)
            } else {
                None
            }
        })
    }
}
