//! Photographs media in a set-up, and fits them.

use std::sync::OnceLock;

use farm_tests::coverage::Answer;
use farm_tests::statistics::Normal;
use farm_tests::stored;
use optics_fit::{FitDictionary, measure};
use optics_model::fit::{FitOptions, FitSettings, Measured, PhaseModel};
use optics_model::grid::{Axes, NoiseLevel, Responses};
use optics_model::phase::PhaseShape;
use optics_model::scene::{Scene, Scope};
use optics_model::{Grid, MeasuredProfile, Measurement, Medium, Walks};
use optics_tracer::SeenBase;
use rayon::prelude::*;

use super::scenes::{BASE_SPREAD, ChangedSetUp, HAZE, lab};
use crate::measure::{IOR, SLABS_MM, centres_mm, noisy, traced, unknown_factor, values};

/// Noise of a pixel as a share of its value.
pub(super) const NOISE: f64 = 0.004;
/// Walks of a profile.
pub(super) const WALKS: u64 = 2_000_000;
/// Error of a level that these walks leave: with flaws it counts as one of the gain.
const LEVEL: f64 = 0.0008;
/// Path through slip and gels above and below a slab.
const SLIP_AND_GEL_MM: f64 = 0.21;
/// Nodes of a dictionary's axes.
#[derive(Debug, Clone, Copy)]
pub(super) enum Nodes {
    Few,
    Lab,
}

/// Dictionary of the scene with its responses, or with those to the phase function alone.
pub(super) fn dictionary(nodes: Nodes, uncertain: bool) -> &'static FitDictionary {
    static ALL: [OnceLock<&FitDictionary>; 4] = [const { OnceLock::new() }; 4];
    ALL[2 * nodes as usize + usize::from(uncertain)].get_or_init(|| {
        let mut priors = lab().priors().to_vec();
        priors.retain(|prior| uncertain || prior.kind().is_of_phase());
        dictionary_of(&lab().with_priors(priors).unwrap(), nodes)
    })
}

/// Dictionary of a scene with its responses.
pub(super) fn dictionary_of(scene: &Scene, nodes: Nodes) -> &'static FitDictionary {
    let grid = match nodes {
        Nodes::Few => Grid::new(scene.clone(), few_nodes(), Walks::PAPER, 1, false),
        Nodes::Lab => Grid::new(scene.clone(), Axes::lab(), NoiseLevel::Paper, 1, false),
    };
    let (grid, base) = (grid.unwrap(), SeenBase::of(scene));
    let responses = Responses::of(scene, grid.axes(), |varied| base.through(varied)).unwrap();
    let grid = responses.map_or(Ok(grid.clone()), |responses| grid.with_responses(responses)).unwrap();
    stored::dictionary(&grid)
}

fn few_nodes() -> Axes {
    Axes {
        sigma_t_per_mm: (0..9).map(|i| 1.6 * libm::pow(6.25_f64, f64::from(i) / 8.0)).collect(),
        albedo: (0..20).map(|i| 1.0 - (0.9 - f64::from(i) * 0.88 / 19.0).powi(2)).collect(),
        g: vec![0.2, 0.4, 0.6],
        thickness_mm: SLABS_MM.to_vec(),
        sample_ior: vec![IOR],
    }
}

/// Materials in a set-up.
#[derive(Debug)]
pub(super) struct SetUpSession {
    set_up: ChangedSetUp,
    channels: Vec<String>,
    /// By material and channel.
    media: Vec<Vec<Medium>>,
    /// Whether thicknesses, edges, gains, zeros and slopes have random errors according to their priors.
    flawed: bool,
    /// Whether gain, zero and slope of a slab are the same in all channels.
    common: bool,
    seed: u64,
}

impl SetUpSession {
    /// The six media of the table.
    pub(super) fn of_row(set_up: ChangedSetUp) -> Self {
        let media = [(6.0, 0.9991), (4.5, 0.7), (7.5, 0.98), (2.5, 0.98), (3.75, 0.995), (5.5, 0.35)];
        let media = media.map(|(s, a)| Medium::new(s, a, 0.4).unwrap()).to_vec();
        Self { flawed: false, ..Self::of_one_channel(set_up, media, 0) }
    }

    fn of_one_channel(set_up: ChangedSetUp, media: Vec<Medium>, seed: u64) -> Self {
        let media = media.into_iter().map(|medium| vec![medium]).collect();
        Self { set_up, channels: vec!["R".to_owned()], media, flawed: true, common: false, seed }
    }

    /// The six media of the table with other mean cosines, without errors of the set-up.
    pub(super) fn of_row_at(set_up: ChangedSetUp, g: [f64; 6]) -> Self {
        let of_row = Self::of_row(set_up);
        let at =
            |(m, g): (&Vec<Medium>, f64)| vec![Medium::new(m[0].sigma_t_per_mm(), m[0].albedo(), g).unwrap()];
        Self { media: of_row.media.iter().zip(g).map(at).collect(), ..of_row }
    }

    /// Random media with these phase functions, in the scene itself otherwise.
    pub(super) fn of_phases(number: u64, phases: Vec<PhaseShape>) -> Self {
        let materials = phases.len();
        Self {
            set_up: ChangedSetUp::none(materials).with_phases(phases),
            ..Self::random(number, materials, false)
        }
    }

    /// Random media within the dictionary, in a random set-up or in the scene itself.
    pub(super) fn random(number: u64, materials: usize, changed: bool) -> Self {
        let mut random = Normal::new(910_000 + number);
        let g = 0.1 + 0.6 * random.uniform();
        let mut medium = || {
            let sigma_t = random.log_uniform(1.3, 8.0);
            Medium::new(sigma_t, 1.0 - random.log_uniform(2e-3, 0.6), g).unwrap()
        };
        let media: Vec<Medium> = (0..6).map(|_| medium()).take(materials).collect();
        let drawn = ChangedSetUp::random(&mut random, materials);
        // The spread of ln(1 − g) over the materials has the fit's prior.
        let spread = if changed { 0.1 * random.normal() } else { 0.0 };
        let with_own_g = |m: &Medium| {
            let g = 1.0 - (1.0 - g) * libm::exp(spread * random.normal());
            Medium::new(m.sigma_t_per_mm(), m.albedo(), g.clamp(0.0, 0.79)).unwrap()
        };
        let media = media.iter().map(with_own_g).collect();
        let set_up = if changed { drawn } else { ChangedSetUp::none(materials) };
        Self::of_one_channel(set_up, media, 1 + number)
    }

    /// Random inks with smooth spectra, in a random set-up: scattering falls with a power of the wavelength, and each
    /// absorbs in one line. Flaws are those of photographs, or common to the channels of a slab.
    pub(super) fn of_inks(number: u64, materials: usize, nm: &[f64], common: bool) -> Self {
        let mut random = Normal::new(950_000 + number);
        let g = 0.1 + 0.6 * random.uniform();
        let mut ink = || {
            let (scattering, power) = (random.log_uniform(1.5, 6.0), 1.2 * random.uniform());
            let (base, peak) = (random.log_uniform(0.003, 0.03), random.log_uniform(0.05, 1.5));
            let (centre, width) = (430.0 + 240.0 * random.uniform(), 30.0 + 40.0 * random.uniform());
            let at = |nm: &f64| {
                let s = scattering * libm::pow(550.0 / nm, power);
                let a = base + peak * libm::exp(-0.5 * ((nm - centre) / width).powi(2));
                Medium::new(s + a, s / (s + a), g).unwrap()
            };
            nm.iter().map(at).collect()
        };
        let media = (0..materials).map(|_| ink()).collect();
        let set_up = ChangedSetUp::random(&mut random, materials);
        let channels = nm.iter().map(ToString::to_string).collect();
        Self { set_up, channels, media, flawed: true, common, seed: 10_001 + number }
    }

    fn measurement(&self, material: usize) -> Measurement {
        let of_slab =
            |slab| (0..self.channels.len()).map(move |channel| self.profile(material, slab, channel));
        Measurement::new(format!("m{material}"), (0..2).flat_map(of_slab).collect()).unwrap()
    }

    /// A slab has one thickness in all channels; the other flaws are those of each photograph, if they are not common.
    fn profile(&self, material: usize, slab: usize, channel: usize) -> MeasuredProfile {
        let number = (self.seed * 6 + material as u64) * 2 + slab as u64;
        let of_channel = number + 100_000 * channel as u64;
        let [mut of_slab, mut random] = [number, of_channel].map(|n| Normal::new(920_000 + n));
        let prior = FitSettings::default();
        let off = |random: &mut Normal, std_error: f64| {
            if self.flawed { std_error * random.normal() } else { 0.0 }
        };
        let thickness_mm = SLABS_MM[slab] + off(&mut of_slab, prior.thickness_std_error_mm);
        // The other flaws of the first channel follow in the same stream.
        off(&mut random, prior.thickness_std_error_mm);
        let flaws = if self.common { &mut of_slab } else { &mut random };
        let mut off = |std_error: f64| off(flaws, std_error);
        let (gain, zero) = (1.0 + off(prior.gain_std_error), off(prior.offset_std_error));
        let zero = zero + self.set_up.difference(material, None, HAZE).unwrap_or(0.0);
        let (slope, origin_mm) = (off(prior.slope_std_error), off(prior.origin_std_error_mm));
        let (scene, medium) = (self.set_up.scene(material, slab), &self.media[material][channel]);
        let at = |mm: f64| values(&traced(&scene, medium, mm, WALKS, 930_000 + of_channel), 0);
        let x = centres_mm(&scene);
        let mut values = at(thickness_mm);
        if self.set_up.wedge > 0.0 {
            // The profile at the thickness of each place: a parabola through those of the middle and at 5 mm.
            let [thin, thick] = [-0.5, 0.5].map(|share| at(thickness_mm * (1.0 + share * self.set_up.wedge)));
            for (i, v) in values.iter_mut().enumerate() {
                let u = x[i] / 5.0;
                *v += 0.5 * u * (thick[i] - thin[i]) + 0.5 * u * u * (thick[i] + thin[i] - 2.0 * *v);
            }
        }
        let origin_mm = origin_mm + self.set_up.shift * (thickness_mm + SLIP_AND_GEL_MM);
        let exact: Vec<f64> =
            values.iter().zip(&x).map(|(v, x)| (gain + slope * x / 10.0) * v + zero).collect();
        let (slab, x) = ((&self.channels[channel][..], SLABS_MM[slab]), x.iter().map(|x| x + origin_mm));
        noisy(slab, x.collect(), &exact, |v| NOISE * v.abs(), &mut random)
    }

    /// Fits like `farmctl measure` without further options.
    pub(super) fn measured(&self, dictionary: &FitDictionary) -> Vec<Answer> {
        self.answers(&self.fitted(dictionary, PhaseModel::TwoLobes))
    }

    /// The first channels of the materials.
    pub(super) fn answers(&self, found: &Measured) -> Vec<Answer> {
        let scene = lab();
        let answer = |(m, fit): (usize, &optics_model::fit::MaterialFit)| {
            // The quantities of the session are the same for all materials.
            let truth = |name: &str, slab_mm, prior_mean| {
                let prior = scene.priors().iter().position(|p| scene.name_of(p) == name).unwrap();
                let is_counted = m == 0 || scene.priors()[prior].scope() != Scope::Session;
                let difference = self.set_up.difference(m, slab_mm, prior).filter(|_| is_counted);
                // The session's measurement of a spread is no truth; the scene has none.
                let from = if prior == BASE_SPREAD { 0.0 } else { prior_mean };
                difference.map(|difference| from + difference)
            };
            let refined = fit.channels[0].refined.as_ref().unwrap();
            Answer::of_fit(&fit.material, &self.media[m][0], refined).with_scene(truth)
        };
        found.materials.iter().enumerate().map(answer).collect()
    }

    /// The true media of a material by channel.
    pub(super) fn media(&self, material: usize) -> &[Medium] {
        &self.media[material]
    }

    pub(super) fn materials(&self) -> usize {
        self.media.len()
    }

    /// The true scene of a material's first slab.
    pub(super) fn scene(&self, material: usize) -> Scene {
        self.set_up.scene(material, 0)
    }

    /// The true difference of a quantity of a material from the scene's value.
    pub(super) fn difference(&self, material: usize, prior: usize) -> f64 {
        self.set_up.difference(material, None, prior).unwrap_or(0.0)
    }

    pub(super) fn fitted(&self, dictionary: &FitDictionary, phase: PhaseModel) -> Measured {
        let count = self.media.len();
        let materials: Vec<Measurement> = (0..count).into_par_iter().map(|m| self.measurement(m)).collect();
        let blur_std_error_mm = if self.flawed { 0.0 } else { FitSettings::default().blur_std_error_mm };
        let known = FitSettings::default().gain_std_error;
        let gain_std_error = if self.flawed { libm::hypot(known, LEVEL) } else { known };
        let mut settings =
            FitSettings { refine: true, phase, blur_std_error_mm, gain_std_error, ..FitSettings::default() };
        if let Some(spread_mm) = self.set_up.difference(0, None, BASE_SPREAD).filter(|_| self.flawed) {
            // As from the bare shots of a session.
            let std_error = libm::hypot(0.1 * spread_mm, 0.002);
            let found = spread_mm + std_error * Normal::new(960_000 + self.seed).normal();
            settings.measured[0] = Some([found.max(0.0), std_error]);
        }
        measure(dictionary, &materials, &FitOptions::new(settings).unwrap(), &unknown_factor()).unwrap()
    }
}
