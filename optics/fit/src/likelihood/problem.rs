//! Prepares a measurement for the likelihood: pixels, priors, and the unknowns that profiles share.

pub(crate) mod anisotropies;
pub(crate) mod assembly;
pub(crate) mod channel;
pub(crate) mod form;
pub(crate) mod start;

use optics_model::fit::{FitOptions, FitSettings, Outside, PhaseModel};
use optics_model::measurement::MIN_PIXELS;
use optics_model::scene::{Prior, PriorKind};
use optics_model::{Grid, Invalid, MeasuredProfile, Measurement};

use crate::dictionary::FitDictionary;
use crate::dictionary::axes::held;
use crate::dictionary::axes::{Admissible, find_channel, outside};
use crate::likelihood::point::Line;
use crate::likelihood::term::scatter::scatter_by_side;
use crate::likelihood::term::{Exposed, Term};
use crate::surrogate::Surrogate;
use start::{Compressed, Region, Scan, Source};

/// Pixels whose inner edge lies within this distance of the end of the dictionary's width, or beyond, are left out.
const RIM_MM: f64 = 0.02;

/// One channel of a material.
#[derive(Debug)]
pub(crate) struct ChannelData<'a> {
    pub dictionary: &'a FitDictionary,
    pub material: usize,
    pub measurement: &'a Measurement,
    pub name: &'a str,
    /// Index into the scene's channels.
    pub channel: usize,
    pub profiles: Vec<ProfileData<'a>>,
    pub options: FitOptions,
    admissible: Admissible,
}

/// One profile, with its set-up.
#[derive(Debug)]
pub(crate) struct ProfileData<'a> {
    pub profile: &'a MeasuredProfile,
    /// Pixels within the dictionary's width.
    pixels: std::ops::Range<usize>,
    /// Standard errors of all measured pixels, without the factor μ.
    std_errors: Line,
    origin_mm: f64,
    /// The options with the profile's own values.
    pub set_up: FitSettings,
}

impl<'a> ProfileData<'a> {
    fn new(grid: &Grid, profile: &'a MeasuredProfile, options: &FitOptions) -> Result<Self, Invalid> {
        let origin_mm = profile.setup().origin_mm.unwrap_or(0.0);
        let half = 0.5 * grid.scene().sensor().width_mm() - RIM_MM + 0.5 * profile.pitch_mm();
        let x = profile.x_mm();
        let first = x.partition_point(|x| x - origin_mm < -half);
        let end = x.partition_point(|x| x - origin_mm <= half);
        if end < first + MIN_PIXELS {
            let given = format!("{} to {}", x[0], x[x.len() - 1]);
            let allowed =
                format!("{MIN_PIXELS} pixels within {half:.2} mm of the edge at {origin_mm} mm are needed");
            return Err(Invalid::new("x_mm", given, allowed));
        }
        let std_errors = std_errors(profile)?;
        let set_up = options.settings().of_profile(profile.setup());
        Ok(Self { profile, pixels: first..end, std_errors, origin_mm, set_up })
    }

    /// Whether the profile is brighter or darker than records of these least and greatest means.
    fn outside(&self, levels: (f64, f64), mu: f64) -> Option<Outside> {
        let values = &self.profile.values()[self.pixels.clone()];
        let mean = mu * values.iter().sum::<f64>() / values.len() as f64;
        outside(mean, levels)
    }

    fn term(&self, surrogate: &Surrogate, medium: [f64; 3]) -> Term {
        let (pixels, mu) = (self.pixels.clone(), self.set_up.mu);
        let scaled = |v: &[f64]| -> Line { v[pixels.clone()].iter().map(|v| v * mu).collect() };
        let thickness_mm = self.profile.thickness_mm();
        let exposed = Exposed {
            thickness_mm,
            pitch_mm: self.profile.pitch_mm(),
            x_mm: self.profile.x_mm()[pixels.clone()].to_vec(),
            values: scaled(self.profile.values()),
            std_errors: scaled(&self.std_errors),
            origin_mm: self.origin_mm,
        };
        Term {
            near: surrogate.near(thickness_mm, medium),
            ..Term::new(exposed, &self.set_up, surrogate, medium, libm::log(mu))
        }
    }
}

impl<'a> ChannelData<'a> {
    pub(crate) fn new(
        dictionary: &'a FitDictionary,
        measurement: &'a Measurement,
        material: usize,
        name: &'a str,
        options: &FitOptions,
    ) -> Result<Self, Invalid> {
        let channel = find_channel(dictionary.grid(), name)?;
        check_phase(dictionary.grid(), options)?;
        let of_channel = measurement.profiles().iter().filter(|p| p.channel() == name);
        let surrogate = Surrogate::new(dictionary, channel, 0);
        let profile = |p: &'a MeasuredProfile| {
            surrogate.supported(p.thickness_mm())?;
            ProfileData::new(dictionary.grid(), p, options)
        };
        let profiles = of_channel.map(profile).collect::<Result<Vec<_>, _>>()?;
        let admissible = Admissible::new(dictionary, options)?;
        Ok(Self { dictionary, material, measurement, name, channel, profiles, options: *options, admissible })
    }

    /// Whether the weight of a second lobe of the phase function is estimated.
    pub(crate) fn has_free_phase(&self) -> bool {
        self.options.settings().phase != PhaseModel::HenyeyGreenstein
            && has_uncertain_lobe(self.dictionary.grid())
    }

    /// Number of compared pixels in all profiles.
    pub(crate) fn pixels(&self) -> usize {
        self.profiles.iter().map(|p| p.pixels.len()).sum()
    }

    /// One model for each refractive index of the sample.
    pub(crate) fn surrogates(&self) -> Vec<Surrogate<'a>> {
        let iors = self.dictionary.grid().sample_ior().len();
        (0..iors).map(|ior| Surrogate::new(self.dictionary, self.channel, ior)).collect()
    }

    /// Prepares the search, with a standard deviation of the common factor in addition to the profiles' gains.
    pub(crate) fn scan(&self, surrogates: &[Surrogate], scale_std_error: f64) -> Result<Scan<'a>, Invalid> {
        let view = self.dictionary.whole_view(self.channel);
        let compressed = |data: &ProfileData| {
            let source = Source {
                profile: data.profile,
                origin_mm: data.origin_mm,
                set_up: &data.set_up,
                scale_std_error,
                std_errors: &data.std_errors,
            };
            let found = Compressed::new(self.dictionary, &view, &source);
            found.ok_or_else(|| {
                let allowed = "it must cover some of the dictionary's pixels, and not be the same everywhere";
                Invalid::new("x_mm", format!("{} at {} mm", self.name, data.profile.thickness_mm()), allowed)
            })
        };
        let terms = self.profiles.iter().map(compressed).collect::<Result<_, _>>()?;
        let region = Region {
            admissible: self.admissible.clone(),
            limits: surrogates[0].limits_within(&self.options),
            held: held(self.dictionary.grid(), &self.options).map(|h| h.is_some()),
        };
        Ok(Scan { dictionary: self.dictionary, view, terms, region })
    }

    /// Whether a profile is brighter or darker than all records, in the mean.
    pub(crate) fn outside(&self, scan: &Scan) -> Option<Outside> {
        let thicknesses = scan.terms.iter().map(Compressed::thickness);
        self.profiles.iter().zip(thicknesses).find_map(|(profile, thickness)| {
            let levels = scan.view.value_sketch(thickness).levels;
            profile.outside(levels, self.options.settings().mu)
        })
    }
}

fn is_weight(prior: &Prior) -> bool {
    prior.kind() == PriorKind::SecondLobeWeight
}

fn has_uncertain_lobe(grid: &Grid) -> bool {
    grid.responses().is_some() && grid.scene().priors().iter().any(is_weight)
}

/// Refuses a phase function that the dictionary's scene cannot have.
fn check_phase(grid: &Grid, options: &FitOptions) -> Result<(), Invalid> {
    let is_uncertain = has_uncertain_lobe(grid);
    let is_plain = grid.scene().phase().second_lobe().is_some_and(|second| second.weight() == 0.0);
    let can_be_plain =
        |prior: &Prior| prior.range(grid.scene()).0 + grid.scene().value_of(prior).unwrap_or_default() <= 0.0;
    let is_near_plain = grid.scene().priors().iter().any(|prior| is_weight(prior) && can_be_plain(prior));
    let (given, allowed) = match options.settings().phase {
        PhaseModel::HenyeyGreenstein if is_uncertain && !is_near_plain => {
            ("hg", "the weight of the scene's second lobe is too far from 0: leave it out")
        }
        PhaseModel::HenyeyGreenstein if !is_uncertain && !is_plain => {
            ("hg", "the phase function of the dictionary's scene is exact, and another: leave it out")
        }
        PhaseModel::PerChannel if !is_uncertain => {
            ("per-channel", "the dictionary's scene has no second lobe of uncertain weight: leave it out")
        }
        _ => return Ok(()),
    };
    Err(Invalid::new("phase", given, allowed))
}

/// The measured standard errors, or estimates from the scatter of the values if there are none, or none but 0, as in
/// exact data. A 0 among others is refused: it would be a pixel without noise.
fn std_errors(profile: &MeasuredProfile) -> Result<Line, Invalid> {
    let positive = |errors: &&[f64]| errors.iter().any(|e| *e > 0.0);
    if let Some(given) = profile.std_errors().filter(positive) {
        if let Some(i) = given.iter().position(|e| *e <= 0.0) {
            let allowed = "the likelihood needs standard errors above 0 (or none at all)";
            return Err(Invalid::new(format!("std_errors[{i}]"), given[i], allowed));
        }
        return Ok(given.to_vec());
    }
    let floor = 1e-6 * profile.values().iter().map(|v| v.abs()).fold(1e-6, f64::max);
    let scatter = scatter_by_side(profile.x_mm(), profile.values());
    Ok(scatter.into_iter().map(|e| e.max(floor)).collect())
}
