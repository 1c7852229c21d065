//! Joins the profiles of channels to one system, with one unknown for all profiles that share a quantity.

use std::collections::BTreeMap;

use optics_model::fit::PhaseModel;
use optics_model::scene::{Prior, PriorKind, Scope};
use rayon::prelude::*;

use crate::dictionary::axes::held;
use crate::likelihood::problem::anisotropies::Anisotropies;
use crate::likelihood::problem::{ChannelData, ProfileData};
use crate::likelihood::system::unknowns::{
    ANYWHERE, OF_MEAN, SceneUnknown, Unknown, Unknowns, thickness_prior,
};
use crate::likelihood::system::{State, System};
use crate::likelihood::term::{OF_SLABS, Own, Term, blur};
use crate::surrogate::Surrogate;

/// Greatest change of the logarithm of a slab's thickness by a fit.
const NEAR: f64 = 0.1;

/// The unknowns that several channels share in addition to the factor on μ.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sharing {
    /// Whether anisotropies are related, see [`Anisotropies`].
    pub g: bool,
    /// Standard deviation of ln(1 − g) of a material about the mean of all; 0 for one value.
    pub g_spread: f64,
    /// Standard deviation of the change of ln(1 − g) over 100 nm; 0 for one value.
    pub g_change: f64,
    /// Limits of the logarithm of the factor on μ, if it has no prior.
    pub scale: Option<(f64, f64)>,
}

/// Channels as one system: the profiles of channel i are `terms[i]` of it.
#[derive(Debug)]
pub(crate) struct Assembly<'a> {
    pub system: System<'a>,
    pub terms: Vec<std::ops::Range<usize>>,
    /// The mean of the materials' ln(1 − g), and those of the materials; none if they are one.
    pub g_of_materials: Option<(usize, Vec<usize>)>,
    /// Whether ln(1 − g) is a curve over wavelength.
    pub is_g_curve: bool,
}

impl Assembly<'_> {
    /// Sets the standard deviation of ln(1 − g) of a material about the mean.
    pub(crate) fn set_g_spread(&mut self, spread: f64) {
        for slot in self.g_of_materials.iter().flat_map(|(_, slots)| slots) {
            self.system.unknowns[*slot].prior = Some((0.0, spread));
        }
    }

    pub(crate) fn g_spread(&self) -> Option<f64> {
        let (_, slots) = self.g_of_materials.as_ref()?;
        self.system.unknowns[slots[0]].prior.map(|(_, spread)| spread)
    }
}

/// A quantity of the set-up: one unknown for all profiles in which it is the same.
#[derive(Debug, PartialEq)]
enum SetUpKey<'a> {
    /// The blur of a channel is the same in all photographs with the same prior.
    Blur(&'a str, (f64, f64)),
    /// A material has one slab of each thickness, whatever the channel.
    Thickness(usize, f64),
    /// Gain, zero or slope of a slab, whatever the channel: lamps and mounting change its photographs together.
    Flaw(Own, usize, f64),
}

/// The unknowns of a system under construction, with the quantities that they are.
#[derive(Debug, Default)]
struct Builder<'a> {
    unknowns: Unknowns,
    of_set_up: Vec<(SetUpKey<'a>, usize)>,
    of_scene: Vec<SceneUnknown>,
    /// Means over the slabs of the session, by prior.
    of_slabs: BTreeMap<usize, usize>,
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

    /// Gain, zero and slope of a slab. They are held where a channel is alone.
    fn flaws(&mut self, material: usize, data: &ProfileData, is_shared: bool) -> Vec<usize> {
        let prior = (0.0, if is_shared { 1.0 } else { 0.0 });
        let key = |own| SetUpKey::Flaw(own, material, data.profile.thickness_mm());
        OF_SLABS.iter().map(|own| self.of_set_up(key(*own), prior, ANYWHERE)).collect()
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

/// Standard deviations of its prior at which a spread within the base begins.
const SPREAD_START: f64 = 0.5;

/// The scope of a quantity in a fit.
fn scope(prior: &Prior, phase: PhaseModel) -> Scope {
    let is_per_channel = phase == PhaseModel::PerChannel && prior.kind().is_of_phase();
    if is_per_channel { Scope::Channel } else { prior.scope() }
}

/// Slots of a profile's unknowns for the uncertain quantities of the scene, in their order; none without responses.
fn scene_slots(builder: &mut Builder, data: &ChannelData, thickness_mm: f64) -> Vec<usize> {
    let (grid, phase) = (data.dictionary.grid(), data.options.settings().phase);
    let Some(responses) = grid.responses() else { return Vec::new() };
    let slot = |(index, prior): (usize, &Prior)| {
        let (material, slab_mm, channel) = match scope(prior, phase) {
            Scope::Session => (None, None, None),
            Scope::Material => (Some(data.material), None, None),
            Scope::Slab => (Some(data.material), Some(thickness_mm), None),
            Scope::Channel => (Some(data.material), None, Some(data.channel)),
        };
        let wanted = (index, material, slab_mm, channel);
        let known = builder.of_scene.iter().find(|u| (u.prior, u.material, u.slab_mm, u.channel) == wanted);
        if let Some(known) = known {
            return known.slot;
        }
        let (low, high) = prior.range_of(grid.scene(), &responses.steps_of(index));
        let limits = (low / prior.std_error(), high / prior.std_error());
        // Without weight the second lobe's anisotropy has no effect.
        let without_lobe = phase == PhaseModel::HenyeyGreenstein && prior.kind().is_of_phase();
        let at = match prior.kind() {
            PriorKind::SecondLobeWeight if without_lobe => limits.0,
            // At 0, an end of its range, a spread would leave its effects to others first.
            PriorKind::BaseSpread => SPREAD_START,
            _ => 0.0,
        };
        // A measured value and its error, in standard deviations of the scene's prior.
        let measured = data.options.settings().measured(prior.kind()).map(|[value, std_error]| {
            let from = grid.scene().value_of(prior).unwrap_or_default();
            ((value - from) / prior.std_error(), std_error / prior.std_error())
        });
        let unknowns = &mut builder.unknowns;
        let slot = if slab_mm.is_some() {
            let mean =
                *builder.of_slabs.entry(index).or_insert_with(|| unknowns.known((0.0, OF_MEAN), limits));
            unknowns.about(mean, OF_MEAN, limits)
        } else {
            let of_prior = measured.unwrap_or((0.0, 1.0));
            unknowns.add(
                Some(of_prior),
                limits,
                without_lobe,
                if measured.is_some() { of_prior.0 } else { at },
            )
        };
        let is_measured = measured.is_some();
        builder.of_scene.push(SceneUnknown { prior: index, material, slab_mm, channel, slot, is_measured });
        slot
    };
    grid.scene().priors().iter().enumerate().map(slot).collect()
}

/// Whether other channels have a profile of this slab.
fn others_have(channels: &[ChannelData], data: &ChannelData, profile: &ProfileData) -> bool {
    let is_same = |other: &ProfileData| other.profile.thickness_mm() == profile.profile.thickness_mm();
    let others = channels.iter().filter(|other| other.material == data.material && other.name != data.name);
    others.flat_map(|other| &other.profiles).any(is_same)
}

/// All channels as one system, starting at these media.
pub(crate) fn assemble<'a>(
    channels: &[ChannelData],
    surrogates: &[&'a Surrogate<'a>],
    media: &[[f64; 3]],
    scale: f64,
    sharing: Sharing,
) -> (Assembly<'a>, State) {
    let mut builder = Builder::default();
    let settings = channels[0].options.settings();
    let deviation = settings.ln_mu_std_error();
    let scale_slot = match sharing.scale {
        Some(limits) => builder.unknowns.add(None, limits, limits.0 == limits.1, scale),
        None => builder.unknowns.add(Some((0.0, deviation)), (-0.5, 0.5), deviation == 0.0, scale),
    };
    let mut anisotropies =
        Anisotropies::new(channels, sharing.g.then_some([sharing.g_spread, sharing.g_change]));
    let (mut profiles, mut terms) = (Vec::new(), Vec::new());
    let starts = channels.par_iter().zip(surrogates).zip(media);
    let at_start = starts.map(|((data, surrogate), medium)| {
        data.profiles.iter().map(|profile| profile.term(surrogate, *medium)).collect()
    });
    let at_start: Vec<Vec<Term>> = at_start.collect();
    for (((data, surrogate), medium), at_start) in channels.iter().zip(surrogates).zip(media).zip(at_start) {
        let limits = surrogate.limits_within(&data.options);
        let held = held(data.dictionary.grid(), &data.options);
        let mut medium_slot = |i: usize| builder.unknowns.add(None, limits[i], held[i].is_some(), medium[i]);
        let (s, a) = (medium_slot(0), medium_slot(1));
        let own_g = Unknown { prior: None, about: None, limits: limits[2], held: held[2].is_some() };
        let g = anisotropies.slot((data.material, data.name), &mut builder.unknowns, own_g, medium[2]);
        let first = profiles.len();
        for (profile, mut term) in data.profiles.iter().zip(at_start) {
            let is_shared = others_have(channels, data, profile);
            if is_shared {
                term.share_flaws(OF_MEAN);
            }
            let flaws = builder.flaws(data.material, profile, is_shared);
            let blur = builder.blur(data.name, profile);
            let thickness = builder.thickness(data.material, profile);
            let scene = scene_slots(&mut builder, data, profile.profile.thickness_mm());
            let slots = [vec![s, a, g, scale_slot], flaws, vec![blur, thickness], scene].concat();
            profiles.push((term, *surrogate, slots));
        }
        terms.push(first..profiles.len());
    }
    let (system, state) = System::new(profiles, builder.unknowns, builder.of_scene);
    let (is_g_curve, g_of_materials) = (anisotropies.is_curve(), anisotropies.of_materials());
    (Assembly { system, terms, g_of_materials, is_g_curve }, state)
}
