//! Detects values that are a power of radiance factors, or too large by a common factor, where residuals alone do not
//! show it. A power absorbs much, so that it is named only if no other part of the set-up explains the data as well.
//!
//! A set of materials can absorb either error in its media: χ² stays small and the media are wrong. Values v are therefore
//! replaced by vᵖ, and their standard errors σ by p vᵖ⁻¹ σ, and all unknowns follow. The density of v gains the factor
//! p vᵖ⁻¹ by this, which the normalisation of the error cancels, so that −2 ln L stays comparable between exponents.

use optics_model::fit::{Cause, Suspicion};

use super::minimum::Joint;
use crate::likelihood::point::{BLUR, LN_SCALE, LN_THICKNESS, SHARED};
use crate::likelihood::system::{COARSE, FINE};
use crate::likelihood::system::{State, System};
use crate::likelihood::term::{Own, Term};

/// Fall of −2 ln L from which on a cause is reported: four standard deviations.
const CONVINCING: f64 = 16.0;
/// The first step of ln p, and the greatest distance of ln p from 0.
const STEP: f64 = 0.05;
const FURTHEST: f64 = 1.0;
/// Exponents nearer to 1 than this are not reported.
const NEAR_ONE: f64 = 0.02;
/// Values below this share of the largest are too dark for their noise to follow the power.
const DARK: f64 = 0.01;
/// A cause is as good as another whose fall of −2 ln L is at most this much larger.
const AS_GOOD: f64 = 6.0;
/// Factor on the standard deviations of priors that are tried.
const WIDER: f64 = 10.0;
/// Limits of the logarithm of a factor on the given μ.
const SCALES: (f64, f64) = (-0.7, 0.7);

/// A cause that explains all channels better than the set-up as it was given, with the misfit that it leaves in each
/// channel.
pub(super) struct Response {
    cause: Cause,
    amount: f64,
    /// The fall of −2 ln L.
    fall: f64,
    misfits_left: Vec<f64>,
}

impl Response {
    /// The likelier of the two causes; none if neither is convincing. A factor that is being estimated is no cause.
    pub(super) fn find(joint: &Joint, scale_is_free: bool) -> Option<Self> {
        let system = with_terms(joint, Term::clone);
        let given = system.descend(joint.state.clone(), None, FINE);
        let factor = if scale_is_free { None } else { factor(joint, system, &given) };
        let likelier = [exponent(joint, &given), factor].into_iter().flatten();
        let found = likelier.max_by(|a, b| a.fall.total_cmp(&b.fall))?;
        if found.cause != Cause::Exponent {
            return Some(found);
        }
        // Causes in single profiles are named with the profile, and quantities of the scene in its table.
        let as_good = |freed: Freed| freed.fall(joint, &given) >= found.fall - AS_GOOD;
        (!Freed::ALL.into_iter().any(as_good)).then_some(found)
    }

    pub(super) fn suspicion(&self, channel: usize) -> Suspicion {
        let misfit_left = self.misfits_left[channel];
        Suspicion { cause: self.cause, thickness_mm: None, amount: self.amount, misfit_left }
    }
}

/// A part of the set-up with wide priors.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Freed {
    Thickness,
    Blur,
    /// Edge, gain, zero, slope or wedge of each profile.
    Own(Own),
    OfScene,
}

impl Freed {
    const ALL: [Self; 7] = [
        Self::Thickness,
        Self::Blur,
        Self::Own(Own::Origin),
        Self::Own(Own::Zero),
        Self::Own(Own::Slope),
        Self::Own(Own::Wedge),
        Self::OfScene,
    ];

    /// The fall of −2 ln L with these priors, from the minimum with those given.
    fn fall(self, joint: &Joint, given: &State) -> f64 {
        let mut system = with_terms(joint, Term::clone);
        let mut from = given.clone();
        match self {
            Self::Thickness => widen(&mut system, |slots| vec![slots[LN_THICKNESS]]),
            Self::Blur => widen(&mut system, |slots| vec![slots[BLUR]]),
            Self::OfScene => widen(&mut system, |slots| slots[SHARED..].to_vec()),
            Self::Own(own) => {
                for (term, of_term) in system.terms.iter_mut().zip(&mut from.own) {
                    for (prior, value) in term.priors.iter_mut().zip(of_term) {
                        if prior.own == own {
                            prior.std_error *= WIDER;
                            *value /= WIDER;
                        }
                    }
                }
            }
        }
        given.cost - system.descend(from, None, FINE).cost
    }
}

/// Widens the priors of some unknowns of each profile.
fn widen(system: &mut System, chosen: impl Fn(&[usize]) -> Vec<usize>) {
    let mut slots: Vec<usize> = system.slots.iter().flat_map(|slots| chosen(slots)).collect();
    slots.sort_unstable();
    slots.dedup();
    for slot in slots {
        if let Some((_, std_error)) = &mut system.unknowns[slot].prior {
            *std_error *= WIDER;
        }
    }
}

/// A place of the search: ln p with the minimum there.
struct Tried {
    ln_power: f64,
    state: State,
}

/// The exponent with the lowest minimum, from the minimum of the values as they were given.
fn exponent(joint: &Joint, given: &State) -> Option<Response> {
    let with_power = |ln_power: f64| with_terms(joint, |term| raised(term, libm::exp(ln_power)));
    let at = |ln_power: f64, from: &State, tolerance: f64| {
        let state = with_power(ln_power).descend(from.clone(), None, tolerance);
        Tried { ln_power, state }
    };
    // Rough minima show whether a fall of the required size can be expected.
    let [below, above] = [-STEP, STEP].map(|ln_power| at(ln_power, given, COARSE));
    let first = given.cost;
    let curvature = below.state.cost - 2.0 * first + above.state.cost;
    let slope = below.state.cost - above.state.cost;
    let promised = if curvature > 0.0 { slope.powi(2) / (8.0 * curvature) } else { f64::INFINITY };
    if promised < 0.5 * CONVINCING {
        return None;
    }
    let side = if below.state.cost < above.state.cost { below } else { above };
    let mut best = at(side.ln_power, &side.state, FINE);
    let mut step = best.ln_power;
    while step.abs() > 0.2 * STEP {
        let there = at(best.ln_power + step, &best.state, FINE);
        if there.ln_power.abs() <= FURTHEST && there.state.cost < best.state.cost {
            best = there;
            step *= 1.5;
        } else {
            step *= -0.4;
        }
    }
    let amount = libm::exp(-best.ln_power);
    let fall = first - best.state.cost;
    let convincing = fall > CONVINCING && (amount - 1.0).abs() > NEAR_ONE;
    convincing.then(|| {
        let system = with_power(best.ln_power);
        let misfits_left = misfits(joint, &system, &best.state);
        Response { cause: Cause::Exponent, amount, fall, misfits_left }
    })
}

/// A factor on all values, from the minimum of the system with the factor that was given.
fn factor(joint: &Joint, mut system: System, given: &State) -> Option<Response> {
    let slot = system.slots[0][LN_SCALE];
    let unknown = &mut system.unknowns[slot];
    (unknown.prior, unknown.held, unknown.limits) = (None, false, SCALES);
    let mut free = system.descend(given.clone(), None, FINE);
    let fall = given.cost - free.cost;
    if fall <= CONVINCING {
        return None;
    }
    // The media are others with this factor.
    system.add_modes(&mut free);
    let free = system.descend(free, None, FINE);
    // Values are too large where the factor on μ is below 1.
    let amount = libm::exp(given.x[slot] - free.x[slot]) - 1.0;
    Some(Response { cause: Cause::Gain, amount, fall, misfits_left: misfits(joint, &system, &free) })
}

/// The system with other terms.
fn with_terms<'a>(joint: &Joint<'a>, change: impl Fn(&Term) -> Term) -> System<'a> {
    let system = &joint.assembly.system;
    System { terms: system.terms.iter().map(change).collect(), coupling: None, ..system.clone() }
}

fn raised(term: &Term, power: f64) -> Term {
    let dark = DARK * term.values.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let by = |v: f64| power * libm::pow(v.abs().max(dark), power - 1.0);
    Term {
        values: term.values.iter().map(|v| v.signum() * libm::pow(v.abs(), power)).collect(),
        std_errors: term.values.iter().zip(&term.std_errors).map(|(v, e)| e * by(*v)).collect(),
        ..term.clone()
    }
}

/// Root mean square of each channel's residuals.
fn misfits(joint: &Joint, system: &System, state: &State) -> Vec<f64> {
    let linear = system.linear(&state.x, &state.own);
    let channel = |terms: &std::ops::Range<usize>| {
        let kept = terms.clone().flat_map(|t| {
            let pixels = linear[t].residuals.iter().zip(&system.terms[t].left_out);
            pixels.filter(|(_, out)| !**out).map(|(r, _)| r * r)
        });
        let (sum, count) = kept.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
        (sum / f64::max(count, 1.0)).sqrt()
    };
    joint.assembly.terms.iter().map(channel).collect()
}
