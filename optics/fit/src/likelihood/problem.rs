//! A measurement made ready for the likelihood: pixels, priors, and which profiles share what.

use nalgebra::DVector;
use optics_model::fit::{FitOptions, Outside};
use optics_model::measurement::MIN_PIXELS;
use optics_model::scene::{Prior, Scope};
use optics_model::{Grid, Invalid, MeasuredProfile, Measurement};

use super::camera::Camera;
use super::form::Loose;
use super::scatter::scatter_by_side;
use super::start::{Compressed, Region, Scan, Source};
use super::system::{State, System};
use super::term::{Exposed, OwnErrors, Term, White};
use super::unknowns::{SceneUnknown, Unknown};
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
    pub thickness_std_error_mm: f64,
    origin_mm: f64,
    origin_std_error_mm: f64,
    /// Mean and standard deviation of the blur's coordinate.
    pub blur: (f64, f64),
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
        let (setup, settings) = (profile.setup(), options.settings());
        let origin_mm = setup.origin_mm.unwrap_or(0.0);
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
        let blur_mm = setup.blur_mm.unwrap_or(settings.blur_mm);
        let blur_error = setup.blur_std_error_mm.unwrap_or(settings.blur_std_error_mm);
        Ok(Self {
            profile,
            pixels: first..end,
            std_errors,
            thickness_std_error_mm: setup.thickness_std_error_mm.unwrap_or(settings.thickness_std_error_mm),
            origin_mm,
            origin_std_error_mm: setup.origin_std_error_mm.unwrap_or(settings.origin_std_error_mm),
            blur: blur::prior(blur_mm, blur_error),
        })
    }

    /// Whether the profile is brighter or darker than records of these least and greatest means.
    pub(super) fn outside(&self, levels: (f64, f64), mu: f64) -> Option<Outside> {
        let values = &self.profile.values()[self.pixels.clone()];
        let mean = mu * values.iter().sum::<f64>() / values.len() as f64;
        outside(mean, levels)
    }

    fn term(&self, grid: &Grid, options: &FitOptions, surrogate: &Surrogate, medium: [f64; 3]) -> Term {
        let (settings, sensor) = (options.settings(), grid.scene().sensor());
        let pixels = self.pixels.clone();
        let scaled = |v: &[f64]| -> Line { v[pixels.clone()].iter().map(|v| v * settings.mu).collect() };
        let x_mm = self.profile.x_mm()[pixels.clone()].to_vec();
        let camera = Camera::new(&x_mm, self.profile.pitch_mm(), sensor.width_mm(), sensor.pixels());
        let thickness_mm = self.profile.thickness_mm();
        let exposed = Exposed {
            thickness_mm,
            camera,
            x_mm,
            values: scaled(self.profile.values()),
            std_errors: scaled(&self.std_errors),
            origin_mm: self.origin_mm,
        };
        let errors = OwnErrors {
            origin_mm: self.origin_std_error_mm,
            gain: settings.gain_std_error,
            zero: settings.offset_std_error * settings.mu,
            slope: settings.slope_std_error,
        };
        Term {
            near: surrogate.near(thickness_mm, medium),
            white: White::of(surrogate, thickness_mm, medium, settings.mu.ln()),
            responses: surrogate.responses(thickness_mm, medium),
            ..Term::new(exposed, &errors)
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
        let settings = self.options.settings();
        let view = self.dictionary.whole_view(self.channel);
        let compressed = |data: &ProfileData| {
            let loose = Loose {
                gain: settings.gain_std_error.hypot(scale_std_error),
                zero: settings.offset_std_error * settings.mu,
                slope: settings.slope_std_error,
                origin_mm: data.origin_std_error_mm,
                blur_mm2: blur::variance_mm2(data.blur.0 + data.blur.1),
            };
            let source = Source {
                profile: data.profile,
                origin_mm: data.origin_mm,
                mu: settings.mu,
                std_errors: &data.std_errors,
            };
            let found = Compressed::new(self.dictionary, &view, &source, &loose);
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

/// The unknowns of a system under construction.
#[derive(Debug, Default)]
struct Unknowns {
    all: Vec<Unknown>,
    x: Vec<f64>,
    blurs: Vec<(String, (f64, f64), usize)>,
    thicknesses: Vec<(usize, f64, usize)>,
    of_scene: Vec<SceneUnknown>,
}

impl Unknowns {
    fn add(&mut self, prior: Option<(f64, f64)>, limits: (f64, f64), held: bool, x: f64) -> usize {
        self.all.push(Unknown { prior, limits, held });
        self.x.push(x.clamp(limits.0, limits.1));
        self.all.len() - 1
    }

    /// The blur of a channel is the same in all photographs with the same prior.
    fn blur(&mut self, channel: &str, prior: (f64, f64)) -> usize {
        if let Some((.., i)) = self.blurs.iter().find(|(name, t, _)| name == channel && *t == prior) {
            return *i;
        }
        let i =
            self.add(Some(prior), (blur::coordinate(0.0), prior.0 + 20.0 * prior.1), prior.1 == 0.0, prior.0);
        self.blurs.push((channel.to_owned(), prior, i));
        i
    }

    /// A material has one slab of each thickness, whatever the channel.
    fn thickness(&mut self, material: usize, data: &ProfileData) -> usize {
        let nominal = data.profile.thickness_mm();
        if let Some((.., i)) = self.thicknesses.iter().find(|(m, t, _)| *m == material && *t == nominal) {
            return *i;
        }
        let (middle, deviation) = (nominal.ln(), data.thickness_std_error_mm / nominal);
        let i = self.add(Some((middle, deviation)), (middle - NEAR, middle + NEAR), deviation == 0.0, middle);
        self.thicknesses.push((material, nominal, i));
        i
    }
}

/// Unknowns for the uncertain quantities of a grid's scene, in their order, of a slab; none without responses.
fn scene_slots(unknowns: &mut Unknowns, grid: &Grid, material: usize, thickness_mm: f64) -> Vec<usize> {
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
            unknowns.of_scene.iter().find(|u| (u.prior, u.material, u.slab_mm) == (index, material, slab_mm));
        if let Some(known) = known {
            return known.slot;
        }
        let (low, high) = prior.range(grid.scene());
        let limits = (low / prior.std_error(), high / prior.std_error());
        let slot = unknowns.add(Some((0.0, 1.0)), limits, false, 0.0);
        unknowns.of_scene.push(SceneUnknown { prior: index, material, slab_mm, slot });
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
    let mut unknowns = Unknowns::default();
    let settings = channels[0].options.settings();
    let deviation = settings.mu_std_error / settings.mu;
    let scale_slot = match sharing.scale {
        Some(limits) => unknowns.add(None, limits, limits.0 == limits.1, scale),
        None => unknowns.add(Some((0.0, deviation)), (-0.5, 0.5), deviation == 0.0, scale),
    };
    let mut common_g = None;
    let (mut terms, mut slots, mut used, mut ranges) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for ((data, surrogate), medium) in channels.iter().zip(surrogates).zip(media) {
        let limits = surrogate.limits_within(&data.options);
        let held = held(data.dictionary.grid(), &data.options);
        let mut of_medium = |i: usize| unknowns.add(None, limits[i], held[i].is_some(), medium[i]);
        let (s, a) = (of_medium(0), of_medium(1));
        let g = match common_g {
            Some(g) => g,
            None => of_medium(2),
        };
        common_g = sharing.g.then_some(g);
        let first = terms.len();
        for profile in &data.profiles {
            let blur = unknowns.blur(data.name, profile.blur);
            let thickness = unknowns.thickness(data.material, profile);
            let grid = data.dictionary.grid();
            let scene = scene_slots(&mut unknowns, grid, data.material, profile.profile.thickness_mm());
            slots.push([vec![s, a, g, scale_slot, blur, thickness], scene].concat());
            terms.push(profile.term(data.dictionary.grid(), &data.options, surrogate, *medium));
            used.push(*surrogate);
        }
        ranges.push(first..terms.len());
    }
    let own: Vec<Line> = terms.iter().map(|t: &Term| vec![0.0; t.own_count()]).collect();
    let system = System {
        terms,
        surrogates: used,
        slots,
        unknowns: unknowns.all,
        of_scene: unknowns.of_scene,
        coupling: None,
    };
    let state = State { x: DVector::from_vec(unknowns.x), own, cost: f64::INFINITY };
    (Assembly { system, terms: ranges }, state)
}
