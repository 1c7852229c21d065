//! Estimates inks that absorb too much to be measured by themselves, from dilutions of them.
//!
//! Scattering and absorption coefficients of a mixture are the sums of those of its inks, weighted by their fractions. So
//! the profiles of pure inks and of their mixtures are fitted together, over σ_s, √σ_a and ln(1 − g) of the inks
//! (`term/blend`), with the set-up of every profile estimated as for one material. Each measured material is first fitted
//! with a medium of its own: this identifies its dust, and gives the equations from which the inks' descent starts
//! (`mixtures/start`). Intervals follow the profile likelihood (`interval/profile_likelihood`); where mixtures contradict
//! one another by more than their noise, as they do if one was mixed wrongly, intervals are widened by their χ² per degree
//! of freedom (a Birge ratio).

mod answer;
mod limits;
mod start;
#[cfg(test)]
mod tests;

use std::ops::Range;

use nalgebra::DVector;
use optics_model::fit::{ChannelFit, FitOptions, MeasurePlan, Measured, Mixtures, Unmixed};
use optics_model::{Invalid, Measurement};

use crate::dictionary::FitDictionary;
use crate::dictionary::axes::held;
use crate::likelihood::joint::{all_channels, scales};
use crate::likelihood::point::{LN_ONE_MINUS_G, LN_SIGMA_T, ROOT_CO_ALBEDO};
use crate::likelihood::problem::ChannelData;
use crate::likelihood::problem::anisotropies::curve_nm;
use crate::likelihood::problem::assembly::{Assembly, Sharing, assemble};
use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::unknowns::{Unknown, inverse_over_free};
use crate::likelihood::system::{COARSE, FINE};
use crate::likelihood::system::{State, System};
use crate::likelihood::term::Term;
use crate::likelihood::term::blend::{Blend, Ink, InkPart};
use crate::surrogate::{Surrogate, albedo, coordinates, sigma_t};
use answer::{MixtureRequest, Solution};
use limits::{outside, predicted};
use start::{Equation, rank, solve};

/// Information that is added to every unknown when covariances are computed: slabs may not determine their own media.
const HARDLY: f64 = 1e-9;
/// Least σ_s in 1/mm and √σ_a of an ink, in place of 0.
const LEAST: (f64, f64) = (1e-6, 1e-4);
/// Greatest σ_s and σ_a of an ink over the greatest σ_t of the dictionary: inks may lie beyond it, if mixtures do not.
const GREATEST: f64 = 10.0;

/// One channel of a measured material that is an ink or a mixture of inks.
#[derive(Debug)]
struct Slab<'a> {
    data: ChannelData<'a>,
    material: String,
    /// Volume fractions by ink.
    fractions: Vec<f64>,
    /// The range of its profiles among those of all slabs.
    terms: Range<usize>,
    /// Its own medium.
    medium: [f64; 3],
    /// Standard errors of its own σ_s (1 − g) and σ_a, infinite if they are not determined.
    std_errors: [f64; 2],
    left_out: Option<String>,
}

/// Estimates inks from their own profiles and those of their mixtures, starting where each material was measured by
/// itself.
pub(crate) fn unmix(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    mixtures: &Mixtures,
    measured: &Measured,
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Unmixed, Invalid> {
    let inks = mixtures.inks();
    let mixed = mixed_materials(materials, mixtures)?;
    let channels = all_channels(dictionary, &mixed, options)?;
    let fits: Vec<&ChannelFit> = channels
        .iter()
        .map(|data| fit_of(measured, mixed[data.material].material(), data.name))
        .collect::<Result<_, _>>()?;
    let ior = common_ior(dictionary, &fits);
    let models: Vec<Surrogate> =
        channels.iter().map(|data| Surrogate::new(dictionary, data.channel, ior)).collect();
    let sharing = Sharing {
        // Inks have no curve over wavelength: where g is one, it is free in every channel.
        g: plan.common_g
            && held(dictionary.grid(), options)[2].is_none()
            && (plan.g_change == 0.0 || curve_nm(&channels).is_none()),
        g_spread: 0.0,
        g_change: 0.0,
        scale: plan.search_mu.as_ref().map(|range| {
            let scales = scales(Some(range), options.settings().mu);
            (scales[0], scales[scales.len() - 1])
        }),
    };
    let media: Vec<[f64; 3]> = fits.iter().map(|fit| start_of(fit)).collect();
    let scale = libm::log(measured.common.mu / options.settings().mu);
    let surrogates: Vec<&Surrogate> = models.iter().collect();
    let (mut assembly, state) = assemble(&channels, &surrogates, &media, scale, sharing);
    let state = assembly.system.approach(state, COARSE);
    let state = assembly.system.settle(state);
    let slabs = slabs(channels, &mixed, mixtures, &assembly, &state);
    check_rank(&slabs, &inks)?;
    let unmixing = Unmixing { inks: &inks, slabs, assembly: &assembly, common_g: sharing.g };
    let (solved, slabs) = unmixing.solve(&state)?;
    let request = MixtureRequest { dictionary, options, plan, mixtures, fits: &fits };
    Ok(Solution::new(request, &slabs, &solved)?.answer())
}

/// The materials that are inks or mixtures of them.
fn mixed_materials(materials: &[Measurement], mixtures: &Mixtures) -> Result<Vec<Measurement>, Invalid> {
    let names: Vec<&str> = materials.iter().map(Measurement::material).collect();
    if let Some(absent) = mixtures.all().iter().find(|m| !names.contains(&m.material())) {
        let allowed = format!("the measurement has {}", names.join(", "));
        return Err(Invalid::new("mixture.material", absent.material(), allowed));
    }
    let known = |m: &&Measurement| mixtures.parts_of(m.material()).is_some();
    Ok(materials.iter().filter(known).cloned().collect())
}

fn fit_of<'a>(measured: &'a Measured, material: &str, channel: &str) -> Result<&'a ChannelFit, Invalid> {
    let of_material = measured.materials.iter().find(|m| m.material == material);
    let found = of_material.and_then(|m| m.channels.iter().find(|c| c.channel == channel));
    let allowed = "what was measured before does not have it";
    found.ok_or_else(|| Invalid::new("mixture.material", format!("{material}, {channel}"), allowed))
}

/// All inks have one refractive index: that of most fits.
fn common_ior(dictionary: &FitDictionary, fits: &[&ChannelFit]) -> usize {
    let iors = dictionary.grid().sample_ior();
    let found = |fit: &&ChannelFit, ior: f64| fit.refined.as_ref().is_some_and(|r| r.best.sample_ior == ior);
    let count = |i: &usize| fits.iter().filter(|fit| found(fit, iors[*i])).count();
    (0..iors.len()).max_by_key(count).unwrap_or(0)
}

fn start_of(fit: &ChannelFit) -> [f64; 3] {
    let best = fit.refined.as_ref().map_or(&fit.candidates[0], |r| &r.best);
    coordinates(&best.medium)
}

fn slabs<'a>(
    channels: Vec<ChannelData<'a>>,
    materials: &[Measurement],
    mixtures: &Mixtures,
    assembly: &Assembly,
    state: &State,
) -> Vec<Slab<'a>> {
    let system = &assembly.system;
    let linear = system.linear(&state.x, &state.own);
    let information = system.normal(&state.x, &state.own, &linear).information;
    // Slabs that do not determine their own media, such as dark patches, must not hide the information of the others.
    let covariance = inverse_over_free(&system.unknowns, &information, HARDLY);
    let inks = mixtures.inks();
    let slab = |(data, terms): (ChannelData<'a>, Range<usize>)| {
        let parts = mixtures.parts_of(materials[data.material].material()).unwrap_or_default();
        let fraction = |ink: &&str| parts.iter().find(|(name, _)| name == ink).map_or(0.0, |(_, f)| *f);
        let slots = &system.slots[terms.start];
        let std_errors = [0, 1].map(|which| {
            let quantity = Quantity::all(slots)[3 + which];
            let gradient = quantity.gradient(&state.x);
            let variance = covariance.as_ref().map_or(f64::INFINITY, |c| gradient.dot(&(c * &gradient)));
            let value = quantity.value(&state.x);
            // The coordinates are ln σ_s (1 − g) and √σ_a; the second term is for a root of 0.
            if which == 0 {
                libm::exp(value) * variance.sqrt()
            } else {
                2.0 * value * variance.sqrt() + variance
            }
        });
        Slab {
            fractions: inks.iter().map(fraction).collect(),
            medium: [LN_SIGMA_T, ROOT_CO_ALBEDO, LN_ONE_MINUS_G].map(|i| state.x[slots[i]]),
            std_errors,
            left_out: None,
            material: materials[data.material].material().to_owned(),
            data,
            terms,
        }
    };
    channels.into_iter().zip(assembly.terms.iter().cloned()).map(slab).collect()
}

/// Checks that the fractions of the slabs separate the inks in every channel.
fn check_rank(slabs: &[Slab], inks: &[&str]) -> Result<(), Invalid> {
    for slab in slabs {
        let same: Vec<&Slab> = slabs.iter().filter(|s| s.data.channel == slab.data.channel).collect();
        let fractions: Vec<Vec<f64>> =
            same.iter().filter(|s| s.left_out.is_none()).map(|s| s.fractions.clone()).collect();
        let known = rank(&fractions, inks.len());
        if known < inks.len() {
            let given = format!("{} inks in channel {}", inks.len(), slab.data.name);
            let without: Vec<&str> = same.iter().filter_map(|s| s.left_out.as_deref()).collect();
            let allowed = format!(
                "the slabs distinguish only {known} of {}: measure them pure, or in mixtures of other fractions{}{}",
                inks.join(", "),
                if without.is_empty() { "" } else { "; " },
                without.join("; ")
            );
            return Err(Invalid::new("mixtures", given, allowed));
        }
    }
    Ok(())
}

/// Inks to be estimated.
struct Unmixing<'a, 'b> {
    inks: &'b [&'b str],
    slabs: Vec<Slab<'a>>,
    assembly: &'b Assembly<'a>,
    common_g: bool,
}

/// Slots of the inks, by channel of the dictionary's scene and ink.
type Inks = Vec<(usize, Vec<Ink>)>;

impl<'a> Unmixing<'a, '_> {
    /// All slabs whose media the dictionary covers, at their minimum.
    fn solve(mut self, from: &State) -> Result<(Solved<'a>, Vec<Slab<'a>>), Invalid> {
        loop {
            let (mut system, state, inks) = self.system(from);
            let state = system.descend(state, None, COARSE);
            system.move_near(&state.x);
            if !self.leave_out(&system, &state)? {
                let state = system.descend(state, None, FINE);
                return Ok((Solved { system, state, inks, common_g: self.common_g }, self.slabs));
            }
        }
    }

    /// The system of the profiles that are not left out, with the inks at the solution of their linear equations.
    fn system(&self, from: &State) -> (System<'a>, State, Inks) {
        let whole = &self.assembly.system;
        let (mut unknowns, mut x) = (whole.unknowns.clone(), from.x.clone());
        // The medium of a slab follows from its inks.
        for slots in &whole.slots {
            for i in [LN_SIGMA_T, ROOT_CO_ALBEDO, LN_ONE_MINUS_G] {
                unknowns[slots[i]].held = true;
            }
        }
        let inks = self.ink_unknowns(&mut unknowns, &mut x);
        let mut system = System {
            terms: Vec::new(),
            surrogates: Vec::new(),
            slots: Vec::new(),
            unknowns,
            of_scene: whole.of_scene.clone(),
            coupling: None,
            most_steps: whole.most_steps,
        };
        let mut own = Vec::new();
        for slab in self.slabs.iter().filter(|s| s.left_out.is_none()) {
            let of_channel =
                &inks.iter().find(|(c, _)| *c == slab.data.channel).expect("every channel has inks").1;
            let parts = slab.fractions.iter().zip(of_channel).filter(|(f, _)| **f > 0.0);
            let parts: Vec<InkPart> =
                parts.map(|(fraction, ink)| InkPart { fraction: *fraction, ink: *ink }).collect();
            for i in slab.terms.clone() {
                let term = whole.terms[i].clone();
                let limits = predicted(whole.surrogates[i], term.thickness_mm);
                let blend = Some(Blend { parts: parts.clone(), limits });
                system.terms.push(Term { blend, ..term });
                system.surrogates.push(whole.surrogates[i]);
                system.slots.push(whole.slots[i].clone());
                own.push(from.own[i].clone());
            }
        }
        (system, State::new(x, own), inks)
    }

    /// Adds the unknowns of every ink in every channel.
    fn ink_unknowns(&self, unknowns: &mut Vec<Unknown>, x: &mut DVector<f64>) -> Inks {
        let system = &self.assembly.system;
        let mut inks: Inks = Vec::new();
        let mut common: Option<usize> = None;
        for slab in &self.slabs {
            let channel = slab.data.channel;
            if inks.iter().any(|(c, _)| *c == channel) {
                continue;
            }
            let g_slot = system.slots[slab.terms.start][LN_ONE_MINUS_G];
            let free = Unknown { prior: None, about: None, limits: (0.0, 0.0), held: false };
            let g_known = Unknown { held: false, ..system.unknowns[g_slot] };
            let g_known = Unknown { held: Self::g_held(slab), ..g_known };
            let greatest = GREATEST * sigma_t(system.surrogates[slab.terms.start].limits()[LN_SIGMA_T].1);
            let mut add = |unknown: Unknown, at: f64| {
                unknowns.push(unknown);
                *x = x.clone().push(at.clamp(unknown.limits.0, unknown.limits.1));
                unknowns.len() - 1
            };
            let starts = self.starts(channel);
            let of_channel = starts.into_iter().map(|[scattering, root, ln_one_minus_g]| {
                let s = add(Unknown { limits: (LEAST.0, greatest), ..free }, scattering);
                let a = add(Unknown { limits: (LEAST.1, greatest.sqrt()), ..free }, root);
                let g = match common {
                    Some(g) => g,
                    None => add(g_known, ln_one_minus_g),
                };
                common = self.common_g.then_some(g);
                [s, a, g]
            });
            let of_channel = of_channel.collect();
            inks.push((channel, of_channel));
        }
        inks
    }

    fn g_held(slab: &Slab) -> bool {
        held(slab.data.dictionary.grid(), &slab.data.options)[2].is_some()
    }

    /// σ_s, √σ_a and ln(1 − g) of every ink in a channel, as they follow from the slabs' own media.
    fn starts(&self, channel: usize) -> Vec<[f64; 3]> {
        let of_channel =
            || self.slabs.iter().filter(move |s| s.data.channel == channel && s.left_out.is_none());
        let count = of_channel().count() as f64;
        let ln_one_minus_g = of_channel().map(|s| s.medium[LN_ONE_MINUS_G]).sum::<f64>() / count;
        let equations = |which: usize| -> Vec<Equation> {
            let equation = |slab: &Slab| {
                let [s, a, g] = slab.medium;
                let value =
                    if which == 0 { sigma_t(s) * albedo(a) * libm::exp(g) } else { sigma_t(s) * a * a };
                Equation { fractions: slab.fractions.clone(), value, std_error: slab.std_errors[which] }
            };
            of_channel().map(equation).filter(|e| e.std_error.is_finite() && e.std_error > 0.0).collect()
        };
        let n = self.inks.len();
        let (reduced, absorption) = (solve(&equations(0), n, 1.0), solve(&equations(1), n, 1.0));
        // Not quite 0, from which a descent would not return.
        let start = |(r, a): (f64, f64)| {
            [(r / libm::exp(ln_one_minus_g)).max(1e-2), a.max(1e-4).sqrt(), ln_one_minus_g]
        };
        reduced.into_iter().zip(absorption).map(start).collect()
    }

    /// Leaves out slabs whose media the dictionary does not cover; false if there is none.
    fn leave_out(&mut self, system: &System, state: &State) -> Result<bool, Invalid> {
        let mut terms = 0..system.terms.len();
        let mut changed = false;
        for slab in self.slabs.iter_mut().filter(|s| s.left_out.is_none()) {
            let mut of_slab = terms.by_ref().take(slab.terms.len());
            let left_out = of_slab.find_map(|i| outside(system, i, state));
            of_slab.for_each(drop);
            changed |= left_out.is_some();
            slab.left_out = left_out;
        }
        if changed {
            check_rank(&self.slabs, self.inks)?;
        }
        Ok(changed)
    }
}

/// All profiles at their minimum, and the slots of their inks.
struct Solved<'a> {
    system: System<'a>,
    state: State,
    inks: Inks,
    common_g: bool,
}
