//! The lowest minimum of one channel, and the steps to it: media first, then the records' noise and the dust.

use nalgebra::DVector;

use super::Line;
use super::problem::{Assembly, ChannelData, Sharing, assemble};
use super::records_noise::Modes;
use super::robust::{is_dust, specks};
use super::start::{Scan, Start};
use super::system::{State, System};
use crate::surrogate::Surrogate;

/// Cost by which a rough descent, and the last one, may miss their minimum.
const ROUGHLY: f64 = 0.5;
const WELL: f64 = 0.003;
/// A start in the basis is followed if its cost is at most this much above the lowest, and this factor.
const FOLLOWED: (f64, f64) = (60.0, 1.3);
/// Most starts that are followed.
const STARTS: usize = 3;
/// By this factor the noise is made smaller at a time, on the way to a model without dust.
const HARDER: f64 = 0.4;

/// Starts of a channel that are worth following.
pub(super) fn starts(scan: &Scan, surrogates: &[Surrogate]) -> Vec<Start> {
    let mut starts = scan.starts(surrogates, 1.0);
    let lowest = starts.first().map_or(0.0, |s| s.cost);
    starts.retain(|s| s.cost <= lowest + FOLLOWED.0 || s.cost <= FOLLOWED.1 * lowest);
    starts.truncate(STARTS);
    starts
}

/// The system of a channel by itself at the lowest of its minima, and the refractive index of the sample there.
pub(super) fn lowest<'a>(
    data: &ChannelData,
    surrogates: &'a [Surrogate<'a>],
    starts: &[Start],
) -> (Assembly<'a>, State, usize) {
    let follow = |start: &Start| {
        let one = std::slice::from_ref(data);
        let (mut assembly, state) =
            assemble(one, &[&surrogates[start.ior]], &[start.medium], 0.0, Sharing::default());
        leave_out_specks_by_neighbours(&mut assembly.system);
        let state = assembly.system.descend(state, None, ROUGHLY);
        (assembly, state, start.ior)
    };
    let followed = starts.iter().map(follow);
    followed.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost)).expect("a dictionary has a lowest medium")
}

/// Until there is a model, a pixel lies apart if its neighbours do not go along.
pub(super) fn leave_out_specks_by_neighbours(system: &mut System) {
    for term in &mut system.terms {
        term.left_out =
            super::start::without_specks(&term.values, &term.std_errors).iter().map(|c| !c).collect();
    }
}

/// From a rough minimum to the last: with the noise of the records about, and without dust.
pub(super) fn settle(system: &mut System, mut state: State) -> State {
    add_modes(system, &mut state);
    for term in &mut system.terms {
        term.robust = true;
        term.left_out.fill(false);
    }
    // Dust pulls at a first model, and what is dust is not plain before there is a good one: so the noise is taken to be
    // as large as most residuals are, and made smaller step by step.
    let mut softness = f64::INFINITY;
    while softness > 1.0 {
        softness = (HARDER * softness).min(typical_residual(system, &state)).max(1.0);
        system.terms.iter_mut().for_each(|term| term.softness = softness);
        state = system.descend(state, None, ROUGHLY);
    }
    for _ in 0..2 {
        if leave_out_specks(system, &state) {
            state = system.descend(state, None, WELL);
        }
    }
    add_modes(system, &mut state);
    system.descend(state, None, WELL)
}

/// The records' noise where the state is, for every profile.
fn add_modes(system: &mut System, state: &mut State) {
    use rayon::prelude::*;
    let modes = |i: usize| {
        let (term, point) = (&system.terms[i], system.point(i, &state.x));
        let factors = system.surrogates[i].noise_factors_at(point.thickness_mm(), point.medium());
        let origin = term.origin_mm(&state.own[i]);
        Modes::new(&factors, &term.camera, origin, point.blur_mm2(), &term.std_errors)
    };
    let found: Vec<Modes> = (0..system.terms.len()).into_par_iter().map(modes).collect();
    for ((term, own), found) in system.terms.iter_mut().zip(&mut state.own).zip(found) {
        own.truncate(term.priors.len());
        own.resize(term.priors.len() + found.modes.len(), 0.0);
        (term.modes, term.rest_variances) = (found.modes, found.rest_variances);
    }
}

/// What the standard deviation of residuals would be if those of most pixels were normal, in that of the noise.
fn typical_residual(system: &System, state: &State) -> f64 {
    let linear = system.linear(&state.x, &state.own);
    let median = |residuals: &Line| {
        let mut sizes: Line = residuals.iter().map(|r| r.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        1.4826 * sizes[sizes.len() / 2]
    };
    linear.iter().map(|l| median(&l.residuals)).fold(0.0, f64::max)
}

/// Leaves out the pixels that do not belong to their profiles; false if they are the same as before.
fn leave_out_specks(system: &mut System, state: &State) -> bool {
    let linear = system.linear(&state.x, &state.own);
    let mut changed = false;
    for (term, linear) in system.terms.iter_mut().zip(linear) {
        let found = specks(&linear.residuals);
        let dusty = is_dust(&found);
        let left_out = if dusty { found } else { vec![false; linear.residuals.len()] };
        changed |= left_out != term.left_out || dusty != term.robust;
        (term.left_out, term.robust) = (left_out, dusty);
    }
    changed
}

/// The state with some unknowns moved and held there, all else following.
pub(super) fn held_at(system: &System, state: &State, places: &[(usize, f64)]) -> State {
    let mut unknowns = system.unknowns.clone();
    let mut x: DVector<f64> = state.x.clone();
    for (i, value) in places {
        unknowns[*i].held = true;
        x[*i] = *value;
    }
    let own: Vec<Line> = state.own.clone();
    let held = System {
        terms: system.terms.clone(),
        surrogates: system.surrogates.clone(),
        slots: system.slots.clone(),
        unknowns,
        coupling: system.coupling.clone(),
    };
    held.descend(State { x, own, cost: f64::INFINITY }, None, ROUGHLY)
}
