//! A measurement made ready for the likelihood: pixels, priors, and which profiles share what.

use nalgebra::DVector;
use optics_model::fit::{FitOptions, FitSettings, Outside};
use optics_model::measurement::MIN_PIXELS;
use optics_model::scene::{Prior, Scope};
use optics_model::{Grid, Invalid, MeasuredProfile, Measurement};

use super::scatter::scatter_by_side;
use super::start::{Compressed, Region, Scan, Source};
use super::system::{State, System};
use super::term::{Exposed, Term};
use super::unknowns::{SceneUnknown, Unknowns, thickness_prior};
use super::{Line, blur};
use crate::dictionary::FitDictionary;
use crate::dictionary::axes::held;
use crate::dictionary::axes::{Admissible, find_channel, outside};
use crate::surrogate::Surrogate;

/// How far, in the logarithm, a slab's thickness may be moved by a fit.
const NEAR: f64 = 0.1;
/// Least part of a dictionary's width, at its rim, that is left out: nothing is known beyond.
const RIM_MM: f64 = 0.02;

/// One channel of a material.
#[derive(Debug)]
pub(super) struct ChannelData<'a> {
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

/// One profile, with what is known of its set-up.
#[derive(Debug)]
pub(super) struct ProfileData<'a> {
    pub profile: &'a MeasuredProfile,
    /// Pixels within the dictionary's width.
    pixels: std::ops::Range<usize>,
    /// As measured.
    std_errors: Line,
    origin_mm: f64,
    /// The options with the profile's own values.
    pub set_up: FitSettings,
}

/// What several channels share in addition to the factor on μ.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sharing {
    /// All have the same anisotropy.
    pub g: bool,
    /// Limits of the logarithm of a factor on μ of which nothing else is known.
    pub scale: Option<(f64, f64)>,
}

/// Channels as one system: the profiles of channel i are `terms[i]` of it.
#[derive(Debug)]
pub(super) struct Assembly<'a> {
    pub system: System<'a>,
    pub terms: Vec<std::ops::Range<usize>>,
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
    pub(super) fn outside(&self, levels: (f64, f64), mu: f64) -> Option<Outside> {
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
            ..Term::new(exposed, &self.set_up, surrogate, medium, mu.ln())
        }
    }
}

impl<'a> ChannelData<'a> {
    pub(super) fn new(
        dictionary: &'a FitDictionary,
        measurement: &'a Measurement,
        material: usize,
        name: &'a str,
        options: &FitOptions,
    ) -> Result<Self, Invalid> {
        let channel = find_channel(dictionary.grid(), name)?;
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

    /// Pixels of all profiles that are compared.
    pub(super) fn pixels(&self) -> usize {
        self.profiles.iter().map(|p| p.pixels.len()).sum()
    }

    /// One model for each refractive index of the sample.
    pub(super) fn surrogates(&self) -> Vec<Surrogate<'a>> {
        let iors = self.dictionary.grid().sample_ior().len();
        (0..iors).map(|ior| Surrogate::new(self.dictionary, self.channel, ior)).collect()
    }

    /// Ready to be searched, with a standard deviation of the common factor in addition to the profiles' gains.
    pub(super) fn scan(&self, surrogates: &[Surrogate], scale_std_error: f64) -> Result<Scan<'a>, Invalid> {
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
}

/// As measured, or estimated from the scatter of the values if there are none, or none but 0, as in exact data. A 0 among
/// others is refused: it would be a pixel without noise.
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

/// A quantity of the set-up: one unknown for all profiles in which it is the same.
#[derive(Debug, PartialEq)]
enum SetUpKey<'a> {
    /// The blur of a channel is the same in all photographs with the same prior.
    Blur(&'a str, (f64, f64)),
    /// A material has one slab of each thickness, whatever the channel.
    Thickness(usize, f64),
}

/// The unknowns of a system under construction, and what they are.
#[derive(Debug, Default)]
struct Builder<'a> {
    unknowns: Unknowns,
    of_set_up: Vec<(SetUpKey<'a>, usize)>,
    of_scene: Vec<SceneUnknown>,
}

impl<'a> Builder<'a> {
    fn blur(&mut self, channel: &'a str, data: &ProfileData) -> usize {
        let prior = blur::prior(&data.set_up);
        let limits = (blur::coordinate(0.0), prior.0 + 20.0 * prior.1);
        self.of_set_up(SetUpKey::Blur(channel, prior), prior, limits)
    }

    fn thickness(&mut self, material: usize, data: &ProfileData) -> usize {
        let nominal = data.profile.thickness_mm();
        let prior = thickness_prior(nominal, &data.set_up);
        self.of_set_up(SetUpKey::Thickness(material, nominal), prior, (prior.0 - NEAR, prior.0 + NEAR))
    }

    fn of_set_up(&mut self, key: SetUpKey<'a>, prior: (f64, f64), limits: (f64, f64)) -> usize {
        if let Some((_, slot)) = self.of_set_up.iter().find(|(known, _)| *known == key) {
            return *slot;
        }
        let slot = self.unknowns.known(prior, limits);
        self.of_set_up.push((key, slot));
        slot
    }
}

/// Unknowns for the uncertain quantities of a grid's scene, in their order, of a slab; none without responses.
fn scene_slots(builder: &mut Builder, grid: &Grid, material: usize, thickness_mm: f64) -> Vec<usize> {
    if grid.responses().is_none() {
        return Vec::new();
    }
    let slot = |(index, prior): (usize, &Prior)| {
        let (material, slab_mm) = match prior.scope() {
            Scope::Session => (None, None),
            Scope::Material => (Some(material), None),
            Scope::Slab => (Some(material), Some(thickness_mm)),
        };
        let known =
            builder.of_scene.iter().find(|u| (u.prior, u.material, u.slab_mm) == (index, material, slab_mm));
        if let Some(known) = known {
            return known.slot;
        }
        let (low, high) = prior.range(grid.scene());
        let limits = (low / prior.std_error(), high / prior.std_error());
        let slot = builder.unknowns.known((0.0, 1.0), limits);
        builder.of_scene.push(SceneUnknown { prior: index, material, slab_mm, slot });
        slot
    };
    grid.scene().priors().iter().enumerate().map(slot).collect()
}

/// All channels as one system, beginning at these media.
pub(super) fn assemble<'a>(
    channels: &[ChannelData],
    surrogates: &[&'a Surrogate<'a>],
    media: &[[f64; 3]],
    scale: f64,
    sharing: Sharing,
) -> (Assembly<'a>, State) {
    let mut builder = Builder::default();
    let settings = channels[0].options.settings();
    let deviation = settings.mu_std_error / settings.mu;
    let scale_slot = match sharing.scale {
        Some(limits) => builder.unknowns.add(None, limits, limits.0 == limits.1, scale),
        None => builder.unknowns.add(Some((0.0, deviation)), (-0.5, 0.5), deviation == 0.0, scale),
    };
    let mut common_g = None;
    let (mut terms, mut slots, mut used, mut ranges) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for ((data, surrogate), medium) in channels.iter().zip(surrogates).zip(media) {
        let limits = surrogate.limits_within(&data.options);
        let held = held(data.dictionary.grid(), &data.options);
        let mut of_medium = |i: usize| builder.unknowns.add(None, limits[i], held[i].is_some(), medium[i]);
        let (s, a) = (of_medium(0), of_medium(1));
        let g = match common_g {
            Some(g) => g,
            None => of_medium(2),
        };
        common_g = sharing.g.then_some(g);
        let first = terms.len();
        for profile in &data.profiles {
            let blur = builder.blur(data.name, profile);
            let thickness = builder.thickness(data.material, profile);
            let grid = data.dictionary.grid();
            let scene = scene_slots(&mut builder, grid, data.material, profile.profile.thickness_mm());
            slots.push([vec![s, a, g, scale_slot, blur, thickness], scene].concat());
            terms.push(profile.term(surrogate, *medium));
            used.push(*surrogate);
        }
        ranges.push(first..terms.len());
    }
    let own: Vec<Line> = terms.iter().map(|t: &Term| vec![0.0; t.own_count()]).collect();
    let system = System {
        terms,
        surrogates: used,
        slots,
        unknowns: builder.unknowns.all,
        of_scene: builder.of_scene,
        coupling: None,
    };
    let state = State { x: DVector::from_vec(builder.unknowns.x), own, cost: f64::INFINITY };
    (Assembly { system, terms: ranges }, state)
}
