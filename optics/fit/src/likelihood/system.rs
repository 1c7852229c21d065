//! Profiles that share unknowns, and the descent to the least −2 ln L of all of them together.

use std::cell::OnceCell;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::descent::{Descent, DescentStep};
use super::quantity::Quantity;
use super::term::{Linear, Reduced, Term};
use super::unknowns::{SceneUnknown, Unknown, clamped, free, inverse_over_free, limited_step};
use super::{LN_ONE_MINUS_G, LN_SIGMA_T, Line, Point};
use crate::surrogate::Surrogate;

/// Information below which an unknown is hardly determined, in units in which it is of the order of 1.
const UNDETERMINED: f64 = 100.0;
/// A bound that no descent should reach.
const MOST_STEPS: usize = 400;
/// Standard deviations up to which the prior of a quantity of the scene is normal.
const FIRM: f64 = 2.0;
/// Terms from which on other threads are worth waking.
const MANY: usize = 4;

/// The likelihood of other measurements, as a quadratic in the unknowns about a centre.
#[derive(Debug, Clone)]
pub(super) struct Coupling {
    pub centre: DVector<f64>,
    pub information: DMatrix<f64>,
    /// −½ of the gradient of −2 ln L there.
    pub downhill: DVector<f64>,
}

impl Coupling {
    fn cost(&self, x: &DVector<f64>) -> f64 {
        let away = x - &self.centre;
        away.dot(&(&self.information * &away)) - 2.0 * self.downhill.dot(&away)
    }
}

/// Profiles, each with the unknowns that its shared ones are. Of profiles of mixtures the medium's follow from inks.
#[derive(Debug, Clone)]
pub(super) struct System<'a> {
    pub terms: Vec<Term>,
    pub surrogates: Vec<&'a Surrogate<'a>>,
    pub slots: Vec<Vec<usize>>,
    pub unknowns: Vec<Unknown>,
    /// Those that are of the scene.
    pub of_scene: Vec<SceneUnknown>,
    pub coupling: Option<Coupling>,
}

/// Values of all unknowns, and −2 ln L there.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub x: DVector<f64>,
    /// Each profile's own.
    pub own: Vec<Line>,
    pub cost: f64,
}

/// A quantity held at a value by a stiff quadratic penalty.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeldQuantity {
    pub quantity: Quantity,
    pub at: f64,
    pub stiffness: f64,
}

/// Second derivative and gradient of −2 ln L, halved; profiles' own unknowns eliminated.
#[derive(Debug)]
pub(super) struct Normal {
    pub information: DMatrix<f64>,
    pub downhill: DVector<f64>,
    pub reduced: Vec<Reduced>,
}

/// A state on the way down; the parabola there is taken if it is needed.
struct Evaluation {
    state: State,
    linear: Vec<Linear>,
    normal: OnceCell<Normal>,
}

impl System<'_> {
    pub(super) fn point(&self, term: usize, x: &DVector<f64>) -> Point {
        let slots = &self.slots[term];
        match &self.terms[term].blend {
            None => Point(slots.iter().map(|slot| x[*slot]).collect()),
            Some(blend) => Point(blend.place(slots, x).point),
        }
    }

    /// The same with normal pixels and a dictionary without noise.
    pub(super) fn ideal(&self) -> Self {
        let mut ideal = self.clone();
        for term in &mut ideal.terms {
            term.modes.clear();
            term.rest_variances.clear();
            term.robust = false;
        }
        ideal
    }

    /// Indices of the unknowns that can move.
    pub(super) fn free(&self) -> Vec<usize> {
        free(&self.unknowns)
    }

    /// All profiles at a state.
    pub(super) fn linear(&self, x: &DVector<f64>, own: &[Line]) -> Vec<Linear> {
        let one = |i: usize| self.terms[i].linear(self.surrogates[i], &self.point(i, x), &own[i]);
        if self.terms.len() < MANY {
            (0..self.terms.len()).map(one).collect()
        } else {
            (0..self.terms.len()).into_par_iter().map(one).collect()
        }
    }

    /// −2 ln L of what is known beforehand.
    fn prior_cost(&self, x: &DVector<f64>) -> f64 {
        let priors = (0..self.unknowns.len()).filter_map(|i| self.cost_of_prior(i, x[i]));
        priors.sum::<f64>() + self.coupling.as_ref().map_or(0.0, |c| c.cost(x))
    }

    /// −2 ln L of an unknown's prior at `x`; None if it has none or cannot move.
    pub(super) fn cost_of_prior(&self, slot: usize, x: f64) -> Option<f64> {
        let unknown = &self.unknowns[slot];
        let (mean, sd) = unknown.prior.filter(|_| !unknown.held)?;
        let off = (x - mean) / sd;
        Some(prior_cost(self.prior_weight(slot, off), off))
    }

    /// How much a prior counts at `off` standard deviations. Those of the scene's quantities are rough guesses: beyond
    /// [`FIRM`] they pull no harder, so that data that contradict them are followed.
    fn prior_weight(&self, slot: usize, off: f64) -> f64 {
        if self.of_scene.iter().any(|u| u.slot == slot) { rough_weight(off) } else { 1.0 }
    }

    /// Information of an unknown's prior, and its pull at `x`; zeros without one.
    pub(super) fn prior_pull(&self, slot: usize, x: f64) -> (f64, f64) {
        let unknown = &self.unknowns[slot];
        let Some((mean, sd)) = unknown.prior.filter(|_| !unknown.held) else { return (0.0, 0.0) };
        let weight = self.prior_weight(slot, (x - mean) / sd);
        (weight / (sd * sd), -weight * (x - mean) / (sd * sd))
    }

    fn cost(&self, x: &DVector<f64>, linear: &[Linear]) -> f64 {
        linear.iter().map(|l| l.cost).sum::<f64>() + self.prior_cost(x)
    }

    /// −2 ln L at a state, and its parabola there.
    pub(super) fn look(&self, state: &State) -> (f64, Normal) {
        let linear = self.linear(&state.x, &state.own);
        (self.cost(&state.x, &linear), self.normal(&state.x, &state.own, &linear))
    }

    /// Looks up other thicknesses, and what the white reference and the scene do, again where the media now are.
    pub(super) fn move_near(&mut self, x: &DVector<f64>) {
        let points: Vec<Point> = (0..self.terms.len()).map(|i| self.point(i, x)).collect();
        let each = self.terms.par_iter_mut().zip(&self.surrogates).zip(&points);
        each.for_each(|((term, surrogate), point)| {
            term.near = surrogate.near(term.thickness_mm, point.medium());
            if term.responses.is_some() {
                term.responses = surrogate.responses(point.thickness_mm(), point.medium());
            }
            let white = term.white.as_ref();
            term.white = white.and_then(|w| w.moved(surrogate, point.thickness_mm(), point.medium()));
        });
    }

    pub(super) fn normal(&self, x: &DVector<f64>, own: &[Line], linear: &[Linear]) -> Normal {
        let one = |i: usize| self.terms[i].reduce(&linear[i], &own[i]);
        let reduced: Vec<Reduced> = if linear.len() < MANY {
            (0..linear.len()).map(one).collect()
        } else {
            (0..linear.len()).into_par_iter().map(one).collect()
        };
        self.sum(x, reduced)
    }

    /// The same with all unknowns damped: in proportion to their information, and those that are hardly determined by more.
    fn damped(&self, normal: &Normal, x: &DVector<f64>, damping: f64) -> Normal {
        let mut damped = self.sum(x, normal.reduced.iter().map(|reduced| reduced.damped(damping)).collect());
        for i in 0..x.len() {
            damped.information[(i, i)] += damping * (damped.information[(i, i)] + UNDETERMINED);
        }
        damped
    }

    /// All profiles together with what is known beforehand.
    fn sum(&self, x: &DVector<f64>, reduced: Vec<Reduced>) -> Normal {
        let n = self.unknowns.len();
        let (mut information, mut downhill) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (i, reduced) in reduced.iter().enumerate() {
            self.add_reduced(i, x, reduced, &mut information, &mut downhill);
        }
        for i in 0..n {
            let (of_prior, pull) = self.prior_pull(i, x[i]);
            information[(i, i)] += of_prior;
            downhill[i] += pull;
        }
        if let Some(coupling) = &self.coupling {
            downhill += &coupling.downhill - &coupling.information * (x - &coupling.centre);
            information += &coupling.information;
        }
        Normal { information, downhill, reduced }
    }

    /// Adds a profile's information on the unknowns, and its pull.
    pub(super) fn add_reduced(
        &self,
        term: usize,
        x: &DVector<f64>,
        reduced: &Reduced,
        information: &mut DMatrix<f64>,
        downhill: &mut DVector<f64>,
    ) {
        let mut add = |slots: &[usize], of_slots: &DMatrix<f64>, pull: &DVector<f64>| {
            for (i, slot) in slots.iter().enumerate() {
                downhill[*slot] += pull[i];
                for (j, other) in slots.iter().enumerate() {
                    information[(*slot, *other)] += of_slots[(i, j)];
                }
            }
        };
        match &self.terms[term].blend {
            None => add(&self.slots[term], &reduced.information, &reduced.downhill),
            Some(blend) => {
                let place = blend.place(&self.slots[term], x);
                let (through, slopes) = (place.slopes.transpose(), &place.slopes);
                add(
                    &place.slots,
                    &(&through * &reduced.information * slopes),
                    &(through * &reduced.downhill),
                );
            }
        }
    }

    /// The minimum of −2 ln L below a state, with a quantity held, to within `tolerance`.
    pub(super) fn descend(&self, from: State, held: Option<&HeldQuantity>, tolerance: f64) -> State {
        let spring =
            |x: &DVector<f64>| held.map_or(0.0, |h| h.stiffness * (h.quantity.value(x) - h.at).powi(2));
        let total = |place: &Evaluation| place.state.cost + spring(&place.state.x);
        let step = |from: &Evaluation, damping: f64| {
            let state = &from.state;
            let damped = self.damped(from.normal(self), &state.x, damping);
            let step = self.step(&state.x, &damped, held)?;
            let mut there = state.clone();
            let fall = self.advance(&mut there, &damped, &step);
            let known = |x: &DVector<f64>| self.prior_cost(x) + spring(x);
            let predicted = fall + known(&state.x) - known(&there.x);
            Some(DescentStep { to: self.evaluate(there), predicted })
        };
        let decrement = |place: &Evaluation| {
            let normal = place.normal(self);
            let own: f64 = normal.reduced.iter().map(Reduced::own_decrement).sum();
            own + self.shared_decrement(&place.state.x, normal, held)
        };
        let descent = Descent { most_steps: MOST_STEPS, tolerance };
        descent.run(self.evaluate(from), total, decrement, step).state
    }

    fn evaluate(&self, mut state: State) -> Evaluation {
        let linear = self.linear(&state.x, &state.own);
        state.cost = self.cost(&state.x, &linear);
        Evaluation { state, linear, normal: OnceCell::new() }
    }

    /// Moves a state within its limits, each profile's own unknowns following, and returns the fall of the profiles'
    /// −2 ln L that their quadratics promise.
    pub(super) fn advance(&self, state: &mut State, normal: &Normal, step: &DVector<f64>) -> f64 {
        let from = state.x.clone();
        state.x = clamped(&self.unknowns, &state.x + step);
        let mut fall = 0.0;
        for (i, (reduced, own)) in normal.reduced.iter().zip(&mut state.own).enumerate() {
            let shared = if self.terms[i].blend.is_some() {
                let (from, to) = (self.point(i, &from), self.point(i, &state.x));
                DVector::from_fn(to.0.len(), |k, _| to.0[k] - from.0[k])
            } else {
                let slots = &self.slots[i];
                DVector::from_iterator(slots.len(), slots.iter().map(|s| state.x[*s] - from[*s]))
            };
            let own_step = reduced.own_step(&shared);
            fall += reduced.fall(&shared, &own_step);
            own.iter_mut().zip(own_step.iter()).for_each(|(w, d)| *w += d);
        }
        fall
    }

    /// Whether an extinction or an anisotropy, other than the quantity itself, lies where the dictionary or the bounds end
    /// and would go on, by more than its standard deviation; or, for an absorption, an albedo lies there.
    pub(super) fn at_end(&self, state: &State, quantity: Quantity) -> bool {
        if let Quantity::Absorption([_, albedo, _]) = quantity {
            let (unknown, x) = (&self.unknowns[albedo], state.x[albedo]);
            if !unknown.held && (x <= unknown.limits.0 || x >= unknown.limits.1) {
                return true;
            }
        }
        let ends = |slot: &usize| {
            let (unknown, x) = (&self.unknowns[*slot], state.x[*slot]);
            let at_end = x <= unknown.limits.0 || x >= unknown.limits.1;
            at_end && !unknown.held && quantity != Quantity::Unknown(*slot)
        };
        // Inks may lie beyond the dictionary.
        let direct = self.slots.iter().zip(&self.terms).filter(|(_, term)| term.blend.is_none());
        let slots = direct.flat_map(|(slots, _)| [slots[LN_SIGMA_T], slots[LN_ONE_MINUS_G]]);
        let slots: Vec<usize> = slots.filter(ends).collect();
        if slots.is_empty() {
            return false;
        }
        let linear = self.linear(&state.x, &state.own);
        let normal = self.normal(&state.x, &state.own, &linear);
        slots.into_iter().any(|slot| {
            let outwards = if state.x[slot] <= self.unknowns[slot].limits.0 { -1.0 } else { 1.0 };
            outwards * normal.downhill[slot] > normal.information[(slot, slot)].max(0.0).sqrt()
        })
    }

    fn step(&self, x: &DVector<f64>, normal: &Normal, held: Option<&HeldQuantity>) -> Option<DVector<f64>> {
        let (information, downhill) = with_spring(x, normal, held);
        limited_step(&self.unknowns, x, &information, &downhill)
    }

    /// The fall of −2 ln L that an undamped step of the shared unknowns promises.
    fn shared_decrement(&self, x: &DVector<f64>, normal: &Normal, held: Option<&HeldQuantity>) -> f64 {
        let (information, downhill) = with_spring(x, normal, held);
        let step = limited_step(&self.unknowns, x, &information, &downhill);
        step.map_or(0.0, |step| 2.0 * downhill.dot(&step) - step.dot(&(&information * &step)))
    }

    /// The inverse of an information matrix over the unknowns that can move; zeros elsewhere. None if it is singular.
    pub(super) fn covariance(&self, information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        inverse_over_free(&self.unknowns, information, 0.0)
    }
}

impl Evaluation {
    fn normal(&self, system: &System) -> &Normal {
        self.normal.get_or_init(|| system.normal(&self.state.x, &self.state.own, &self.linear))
    }
}

/// Information and pull with those of the penalty on a quantity.
fn with_spring(
    x: &DVector<f64>,
    normal: &Normal,
    held: Option<&HeldQuantity>,
) -> (DMatrix<f64>, DVector<f64>) {
    let (mut information, mut downhill) = (normal.information.clone(), normal.downhill.clone());
    if let Some(HeldQuantity { quantity, at, stiffness }) = held {
        let gradient = quantity.gradient(x);
        downhill += &gradient * (*stiffness * (at - quantity.value(x)));
        information += &gradient * gradient.transpose() * *stiffness;
    }
    (information, downhill)
}

/// Weight of a rough prior at `off` standard deviations.
fn rough_weight(off: f64) -> f64 {
    (FIRM / off.abs()).min(1.0)
}

/// −2 ln L of a prior with a weight at `off` standard deviations: a square where the weight is 1, and linear beyond.
fn prior_cost(weight: f64, off: f64) -> f64 {
    weight * (2.0 - weight) * off * off
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: at (1, 2) from the centre the form is 18, and the slope adds −2 (0.5 − 2).
    #[test]
    fn coupling_cost_is_its_quadratic() {
        let coupling = Coupling {
            centre: DVector::from_row_slice(&[1.0, 0.0]),
            information: DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 3.0]),
            downhill: DVector::from_row_slice(&[0.5, -1.0]),
        };
        assert_eq!(coupling.cost(&DVector::from_row_slice(&[2.0, 2.0])), 21.0);
    }

    /// A rough prior is normal up to two standard deviations; then its cost is 4 |u| − 4, with the slope that it pulls with.
    #[test]
    fn rough_priors_are_linear_beyond_two() {
        let cost = |off: f64| prior_cost(rough_weight(off), off);
        for (off, expected) in [(0.0, 0.0), (-1.5, 2.25), (2.0, 4.0), (3.0, 8.0), (-5.0, 16.0)] {
            assert!((cost(off) - expected).abs() < 1e-12, "{off}: {}", cost(off));
        }
        for off in [-4.0, -1.0, 0.5, 3.0] {
            let slope = (cost(off + 1e-6) - cost(off - 1e-6)) / 2e-6;
            assert!((slope - 2.0 * rough_weight(off) * off).abs() < 1e-6, "{off}: {slope}");
        }
    }
}
