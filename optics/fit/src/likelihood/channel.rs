//! The lowest minimum of one channel, and the steps to it: media first, then the records' noise and the dust.

use nalgebra::{Cholesky, DVector};

use super::Line;
use super::problem::{Assembly, ChannelData, Sharing, assemble};
use super::records_noise::Modes;
use super::robust::{is_dust, specks};
use super::start::{Scan, Start};
use super::system::{State, System, submatrix};
use super::term::{Own, White};
use crate::surrogate::thickness::NearThickness;
use crate::surrogate::{NoisePlace, Surrogate};

/// Cost by which a rough descent, and the last one, may miss their minimum.
const ROUGHLY: f64 = 0.5;
const WELL: f64 = 0.003;
/// A start in the basis is followed if its cost is at most this much above the lowest, and this factor.
const FOLLOWED: (f64, f64) = (60.0, 1.3);
/// Most starts that are followed.
const STARTS: usize = 3;
/// How far an unknown may move before what depends on where the state is is looked at again: a hundredth of σ_t, say.
const FAR: f64 = 0.01;
/// How far off in mm a descent finds an edge from where it was told.
const FAR_MM: f64 = 0.06;
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
        let (mut assembly, mut state) =
            assemble(one, &[&surrogates[start.ior]], &[start.medium], 0.0, Sharing::default());
        leave_out_specks_by_neighbours(&mut assembly.system);
        place_edges(&assembly.system, &mut state);
        let state = assembly.system.descend(state, None, ROUGHLY);
        (assembly, state, start.ior)
    };
    let followed = starts.iter().map(follow);
    followed.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost)).expect("a dictionary has a lowest medium")
}

/// The lowest minimum of a channel by itself, and the refractive index of the sample there.
pub(super) fn minimum<'a>(
    data: &ChannelData,
    surrogates: &'a [Surrogate<'a>],
    scan: &Scan,
) -> (Assembly<'a>, State, usize) {
    let (mut assembly, state, ior) = lowest(data, surrogates, &starts(scan, surrogates));
    let state = settle(&mut assembly.system, state);
    (assembly, state, ior)
}

/// Until there is a model, a pixel lies apart if its neighbours do not go along.
pub(super) fn leave_out_specks_by_neighbours(system: &mut System) {
    for term in &mut system.terms {
        term.left_out =
            super::form::without_specks(&term.values, &term.std_errors).iter().map(|c| !c).collect();
    }
}

/// Looks along each profile for its edge, if it may lie so far off that a descent would not find it.
pub(super) fn place_edges(system: &System, state: &mut State) {
    for (i, (term, own)) in system.terms.iter().zip(&mut state.own).enumerate() {
        let origin = term.priors.iter().position(|p| p.own == Own::Origin && p.std_error > FAR_MM);
        let Some(origin) = origin else { continue };
        let point = system.point(i, &state.x);
        let steps = (2.5 * term.priors[origin].std_error / FAR_MM).ceil() as i32;
        let cost = |step: i32| {
            let mut there = own.clone();
            there[origin] = f64::from(step) * FAR_MM / term.priors[origin].std_error;
            (term.linear(system.surrogates[i], &point, &there).cost, there)
        };
        let best = (-steps..=steps).map(cost).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, there)) = best {
            *own = there;
        }
    }
}

/// From a rough minimum to the last: with the noise of the records about, and without dust.
pub(super) fn settle(system: &mut System, mut state: State) -> State {
    add_modes(system, &mut state);
    let modes_at = state.clone();
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
    let far = |a: &State, b: &State| (&a.x - &b.x).amax() > FAR;
    if far(&state, &modes_at) {
        add_modes(system, &mut state);
        state = system.descend(state, None, WELL);
    }
    state
}

/// What depends on where the state is, for every profile: the records' noise, the part of other thicknesses, and what the
/// white reference does.
fn add_modes(system: &mut System, state: &mut State) {
    use rayon::prelude::*;
    let modes = |i: usize| {
        let (term, point) = (&system.terms[i], system.point(i, &state.x));
        let noise = system.surrogates[i].noise_factors_at(point.thickness_mm(), point.medium());
        let origin = term.origin_mm(&state.own[i]);
        let near = system.surrogates[i].near(term.thickness_mm, point.medium());
        let white = term.white.as_ref();
        let white = white.and_then(|w| w.moved(system.surrogates[i], point.thickness_mm(), point.medium()));
        (Modes::new(&noise, &term.camera, origin, &term.std_errors), near, white)
    };
    let found: Vec<(Modes, Option<NearThickness>, Option<White>)> =
        (0..system.terms.len()).into_par_iter().map(modes).collect();
    for ((term, own), (found, near, white)) in system.terms.iter_mut().zip(&mut state.own).zip(found) {
        (term.near, term.white) = (near, white);
        own.truncate(term.priors.len());
        own.resize(term.priors.len() + found.modes.len(), 0.0);
        (term.modes, term.rest_variances, term.alike) = (found.modes, found.rest_variances, 1.0);
    }
    let places: Vec<NoisePlace> = (0..system.terms.len())
        .map(|i| {
            let point = system.point(i, &state.x);
            system.surrogates[i].noise_at(point.thickness_mm(), point.medium())
        })
        .collect();
    for (i, (term, own)) in system.terms.iter_mut().zip(&mut state.own).enumerate() {
        term.count_alike(own, places.iter().map(|other| places[i].in_common(other)).sum());
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

/// The state with some unknowns moved and held there, all else following in one step.
pub(super) fn held_at(system: &System, state: &State, places: &[(usize, f64)]) -> State {
    let mut x: DVector<f64> = state.x.clone();
    for (i, value) in places {
        x[*i] = *value;
    }
    let others: Vec<usize> =
        system.free().into_iter().filter(|i| places.iter().all(|(held, _)| held != i)).collect();
    let linear = system.linear(&x, &state.own);
    let normal = system.normal(&x, &state.own, &linear);
    let mut there = State { x, ..state.clone() };
    let mut step = DVector::zeros(there.x.len());
    if let Some(root) = Cholesky::new(submatrix(&normal.information, &others)) {
        let pull = DVector::from_iterator(others.len(), others.iter().map(|i| normal.downhill[*i]));
        others.iter().zip(root.solve(&pull).iter()).for_each(|(i, s)| step[*i] = *s);
    }
    system.advance(&mut there, &normal, &step);
    there
}
