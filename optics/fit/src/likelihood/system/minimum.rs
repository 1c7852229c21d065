//! Minimises −2 ln L of a system by damped Gauss–Newton steps, with or without a quantity held.

use std::cell::OnceCell;

use nalgebra::{DMatrix, DVector};
use optics_model::descent::{Descended, Descent, DescentStep};

use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::unknowns::{clamped, limited_step};
use crate::likelihood::system::{Normal, State, System};
use crate::likelihood::term::Linear;
use crate::likelihood::term::reduced::Reduced;

/// Information below which an unknown is hardly determined, in units in which it is of the order of 1.
const UNDETERMINED: f64 = 100.0;

/// A quantity held at a value by a stiff quadratic penalty.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HeldQuantity {
    pub quantity: Quantity,
    pub at: f64,
    pub stiffness: f64,
}

/// A state on the way down; the quadratic there is computed when it is needed.
struct Evaluation {
    state: State,
    linear: Vec<Linear>,
    normal: OnceCell<Normal>,
}

impl System<'_> {
    /// The minimum of −2 ln L by a descent from a state, with a quantity held, to within `tolerance`.
    pub(crate) fn descend(&self, from: State, held: Option<&HeldQuantity>, tolerance: f64) -> State {
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
            Some(own + self.shared_decrement(&place.state.x, normal, held)?)
        };
        let descent = Descent { most_steps: self.most_steps, tolerance };
        let Descended { at, end } = descent.damped(self.evaluate(from), total, decrement, step);
        let is_held = |i: usize| {
            let ((low, high), x) = (self.unknowns[i].limits, at.state.x[i]);
            x <= low || x >= high
        };
        let end = end.within(self.free().into_iter().any(is_held));
        State { end, ..at.state }
    }

    fn evaluate(&self, mut state: State) -> Evaluation {
        let linear = self.linear(&state.x, &state.own);
        state.cost = self.cost(&state.x, &linear);
        Evaluation { state, linear, normal: OnceCell::new() }
    }

    /// Moves a state within its limits, each profile's own unknowns following, and returns the fall of the profiles'
    /// −2 ln L that their quadratics predict.
    pub(crate) fn advance(&self, state: &mut State, normal: &Normal, step: &DVector<f64>) -> f64 {
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

    /// The quadratic with all unknowns damped: in proportion to their information, and hardly determined ones by more.
    fn damped(&self, normal: &Normal, x: &DVector<f64>, damping: f64) -> Normal {
        let mut damped = self.sum(x, normal.reduced.iter().map(|reduced| reduced.damped(damping)).collect());
        for i in 0..x.len() {
            damped.information[(i, i)] += damping * (damped.information[(i, i)] + UNDETERMINED);
        }
        damped
    }

    fn step(&self, x: &DVector<f64>, normal: &Normal, held: Option<&HeldQuantity>) -> Option<DVector<f64>> {
        let (information, downhill) = with_spring(x, normal, held);
        limited_step(&self.unknowns, x, &information, &downhill)
    }

    /// The fall of −2 ln L that is predicted for an undamped step of the shared unknowns.
    fn shared_decrement(
        &self,
        x: &DVector<f64>,
        normal: &Normal,
        held: Option<&HeldQuantity>,
    ) -> Option<f64> {
        let (information, downhill) = with_spring(x, normal, held);
        let step = limited_step(&self.unknowns, x, &information, &downhill)?;
        Some(2.0 * downhill.dot(&step) - step.dot(&(&information * &step)))
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
