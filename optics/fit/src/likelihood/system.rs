//! Profiles that share unknowns, and the descent to the least −2 ln L of all of them together.

use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::quantity::Quantity;
use super::term::{Linear, Reduced, Term};
use super::{LN_ONE_MINUS_G, LN_SCALE, LN_SIGMA_T, Line, Point, SHARED};
use crate::surrogate::Surrogate;

/// Steps that one descent may take.
const MOST_STEPS: usize = 60;
/// Ridge, added to the information of every unknown when a step is taken, in units in which unknowns are of the order of
/// 1. It keeps undetermined unknowns from dominating the step.
const RIDGE: f64 = 0.1;
/// Terms from which on other threads are worth waking.
const MANY: usize = 4;

/// A quantity that profiles share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unknown {
    /// Mean and standard deviation of what is known beforehand.
    pub prior: Option<(f64, f64)>,
    pub limits: (f64, f64),
    /// It cannot move: it was told, or the dictionary has one value only.
    pub held: bool,
}

/// What other measurements say of the unknowns: a quadratic about a centre.
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
    pub slots: Vec<[usize; SHARED]>,
    pub unknowns: Vec<Unknown>,
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

/// A quantity held at a value, by a spring so stiff that it does not give.
#[derive(Debug, Clone, Copy)]
pub(super) struct Held {
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

impl System<'_> {
    pub(super) fn point(&self, term: usize, x: &DVector<f64>) -> Point {
        let slots = &self.slots[term];
        match &self.terms[term].blend {
            None => Point(slots.map(|slot| x[slot])),
            Some(blend) => Point(blend.place(slots, x).point),
        }
    }

    /// The same with normal pixels and a dictionary without noise.
    pub(super) fn ideal(&self) -> Self {
        let terms = self.terms.iter().cloned();
        let without_noise =
            |term: Term| Term { modes: Vec::new(), rest_variances: Vec::new(), robust: false, ..term };
        Self {
            terms: terms.map(without_noise).collect(),
            surrogates: self.surrogates.clone(),
            slots: self.slots.clone(),
            unknowns: self.unknowns.clone(),
            coupling: self.coupling.clone(),
        }
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
        let known = self.unknowns.iter().zip(x.iter()).filter(|(u, _)| !u.held);
        let priors = known.filter_map(|(u, x)| u.prior.map(|(mean, sd)| ((x - mean) / sd).powi(2)));
        priors.sum::<f64>() + self.coupling.as_ref().map_or(0.0, |c| c.cost(x))
    }

    fn cost(&self, x: &DVector<f64>, linear: &[Linear]) -> f64 {
        linear.iter().map(|l| l.cost).sum::<f64>() + self.prior_cost(x)
    }

    /// −2 ln L at a state, and its parabola there.
    pub(super) fn look(&self, state: &State) -> (f64, Normal) {
        let linear = self.linear(&state.x, &state.own);
        (self.cost(&state.x, &linear), self.normal(&state.x, &state.own, &linear))
    }

    /// Looks up other thicknesses, and what the white reference does, again where the media now are.
    pub(super) fn move_near(&mut self, x: &DVector<f64>) {
        let points: Vec<Point> = (0..self.terms.len()).map(|i| self.point(i, x)).collect();
        let each = self.terms.par_iter_mut().zip(&self.surrogates).zip(&points);
        each.for_each(|((term, surrogate), point)| {
            term.near = surrogate.near(term.thickness_mm, point.medium());
            let white = term.white.as_ref();
            term.white = white.and_then(|w| w.moved(surrogate, point.thickness_mm(), point.medium()));
        });
    }

    pub(super) fn normal(&self, x: &DVector<f64>, own: &[Line], linear: &[Linear]) -> Normal {
        let n = self.unknowns.len();
        let (mut information, mut downhill) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let one = |i: usize| self.terms[i].reduce(&linear[i], &own[i]);
        let reduced: Vec<Reduced> = if linear.len() < MANY {
            (0..linear.len()).map(one).collect()
        } else {
            (0..linear.len()).into_par_iter().map(one).collect()
        };
        for (i, reduced) in reduced.iter().enumerate() {
            self.add_reduced(i, x, reduced, &mut information, &mut downhill);
        }
        for (i, unknown) in self.unknowns.iter().enumerate() {
            if let Some((mean, sd)) = unknown.prior.filter(|_| !unknown.held) {
                information[(i, i)] += 1.0 / (sd * sd);
                downhill[i] -= (x[i] - mean) / (sd * sd);
            }
        }
        if let Some(coupling) = &self.coupling {
            downhill += &coupling.downhill - &coupling.information * (x - &coupling.centre);
            information += &coupling.information;
        }
        Normal { information, downhill, reduced }
    }

    /// Adds what a profile says of the unknowns.
    fn add_reduced(
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

    /// What some profiles say of the unknowns at a state.
    pub(super) fn contribution(
        &self,
        terms: &[usize],
        state: &State,
        normal: &Normal,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.unknowns.len();
        let (mut information, mut downhill) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for i in terms {
            self.add_reduced(*i, &state.x, &normal.reduced[*i], &mut information, &mut downhill);
        }
        (information, downhill)
    }

    /// The unknowns that some profiles share, rising.
    pub(super) fn used_by(&self, terms: &[usize]) -> Vec<usize> {
        let of_term = |i: &usize| -> Vec<usize> {
            match &self.terms[*i].blend {
                None => self.slots[*i].to_vec(),
                Some(blend) => blend.slots().chain(self.slots[*i][LN_SCALE..].iter().copied()).collect(),
            }
        };
        let mut used: Vec<usize> = terms.iter().flat_map(of_term).collect();
        used.sort_unstable();
        used.dedup();
        used
    }

    /// Some profiles as a system of their own at a state, with what the others say there as a quadratic, which counts by
    /// `share`. Its unknowns are those of [`Self::used_by`].
    pub(super) fn part(&self, terms: &[usize], state: &State, normal: &Normal, share: f64) -> (Self, State) {
        let used = self.used_by(terms);
        let (own, own_downhill) = self.contribution(terms, state, normal);
        let (mut rest, mut downhill) = (&normal.information - own, &normal.downhill - own_downhill);
        for slot in &used {
            if let Some((mean, sd)) = self.unknowns[*slot].prior.filter(|_| !self.unknowns[*slot].held) {
                rest[(*slot, *slot)] -= 1.0 / (sd * sd);
                downhill[*slot] += (state.x[*slot] - mean) / (sd * sd);
            }
        }
        let others: Vec<usize> = self.free().into_iter().filter(|i| !used.contains(i)).collect();
        let (information, downhill) = eliminate(&rest, &downhill, &used, &others);
        let centre = DVector::from_iterator(used.len(), used.iter().map(|i| state.x[*i]));
        let coupling =
            Coupling { centre: centre.clone(), information: information * share, downhill: downhill * share };
        let place = |slot: &usize| used.iter().position(|u| u == slot).unwrap_or(0);
        let term = |i: &usize| {
            let term = self.terms[*i].clone();
            Term { blend: term.blend.as_ref().map(|blend| blend.renumbered(place)), ..term }
        };
        let system = Self {
            terms: terms.iter().map(term).collect(),
            surrogates: terms.iter().map(|i| self.surrogates[*i]).collect(),
            slots: terms.iter().map(|i| self.slots[*i].each_ref().map(place)).collect(),
            unknowns: used.iter().map(|i| self.unknowns[*i]).collect(),
            coupling: Some(coupling),
        };
        let own = terms.iter().map(|i| state.own[*i].clone()).collect();
        (system, State { x: centre, own, cost: f64::INFINITY })
    }

    /// Goes down to a minimum of −2 ln L, until a step lowers it by less than `tolerance`.
    pub(super) fn descend(&self, from: State, held: Option<&Held>, tolerance: f64) -> State {
        let spring =
            |x: &DVector<f64>| held.map_or(0.0, |h| h.stiffness * (h.quantity.value(x) - h.at).powi(2));
        let mut state = from;
        let mut linear = self.linear(&state.x, &state.own);
        state.cost = self.cost(&state.x, &linear);
        let mut total = state.cost + spring(&state.x);
        let mut damping = 1e-9;
        let mut normal = self.normal(&state.x, &state.own, &linear);
        for _ in 0..MOST_STEPS {
            let Some(step) = self.step(&state.x, &normal, held, damping) else { break };
            let x = clamped(&self.unknowns, &state.x + step);
            let moved = &x - &state.x;
            let mut there = state.clone();
            self.advance(&mut there, &normal, &moved);
            let own = there.own;
            let new_linear = self.linear(&x, &own);
            let cost = self.cost(&x, &new_linear);
            let gain = total - cost - spring(&x);
            if gain.is_nan() || gain < 0.0 {
                if gain > -tolerance || damping > 1e6 {
                    break;
                }
                damping = (damping * 30.0).max(1e-4);
                continue;
            }
            total = cost + spring(&x);
            (state, linear) = (State { x, own, cost }, new_linear);
            damping *= 0.03;
            if gain < tolerance {
                break;
            }
            normal = self.normal(&state.x, &state.own, &linear);
        }
        state
    }

    /// Moves a state, each profile's own unknowns following.
    pub(super) fn advance(&self, state: &mut State, normal: &Normal, step: &DVector<f64>) {
        let from = state.x.clone();
        state.x = clamped(&self.unknowns, &state.x + step);
        for (i, (reduced, own)) in normal.reduced.iter().zip(&mut state.own).enumerate() {
            let shared = match &self.terms[i].blend {
                None => DVector::from_iterator(SHARED, self.slots[i].iter().map(|s| step[*s])),
                Some(_) => {
                    let (from, to) = (self.point(i, &from), self.point(i, &state.x));
                    DVector::from_fn(SHARED, |k, _| to.0[k] - from.0[k])
                }
            };
            own.iter_mut().zip(reduced.own_step(&shared).iter()).for_each(|(w, d)| *w += d);
        }
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

    fn step(
        &self,
        x: &DVector<f64>,
        normal: &Normal,
        held: Option<&Held>,
        damping: f64,
    ) -> Option<DVector<f64>> {
        let (mut information, mut downhill) = (normal.information.clone(), normal.downhill.clone());
        if let Some(Held { quantity, at, stiffness }) = held {
            let gradient = quantity.gradient(x);
            downhill += &gradient * (*stiffness * (at - quantity.value(x)));
            information += &gradient * gradient.transpose() * *stiffness;
        }
        damped_step(&self.unknowns, x, &information, &downhill, damping)
    }

    /// The inverse of an information matrix over the unknowns that can move; zeros elsewhere. None if it is singular.
    pub(super) fn covariance(&self, information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        inverse_over_free(&self.unknowns, information, 0.0)
    }
}

/// Indices of the unknowns that can move.
pub(super) fn free(unknowns: &[Unknown]) -> Vec<usize> {
    (0..unknowns.len()).filter(|i| !unknowns[*i].held).collect()
}

pub(super) fn clamped(unknowns: &[Unknown], mut x: DVector<f64>) -> DVector<f64> {
    for (x, unknown) in x.iter_mut().zip(unknowns) {
        *x = x.clamp(unknown.limits.0, unknown.limits.1);
    }
    x
}

/// A damped Gauss–Newton step of the unknowns that can move and are not pulled over their limits.
pub(super) fn damped_step(
    unknowns: &[Unknown],
    x: &DVector<f64>,
    information: &DMatrix<f64>,
    downhill: &DVector<f64>,
    damping: f64,
) -> Option<DVector<f64>> {
    let inwards = |i: &usize| {
        let (low, high) = unknowns[*i].limits;
        !((x[*i] <= low && downhill[*i] < 0.0) || (x[*i] >= high && downhill[*i] > 0.0))
    };
    let free: Vec<usize> = free(unknowns).into_iter().filter(inwards).collect();
    let mut matrix = submatrix(information, &free);
    for i in 0..free.len() {
        matrix[(i, i)] = matrix[(i, i)] * (1.0 + damping) + RIDGE;
    }
    let pull = DVector::from_iterator(free.len(), free.iter().map(|i| downhill[*i]));
    let solved = Cholesky::new(matrix)?.solve(&pull);
    let mut step = DVector::zeros(x.len());
    free.iter().zip(solved.iter()).for_each(|(i, s)| step[*i] = *s);
    Some(step)
}

/// The inverse of an information matrix over the unknowns that can move, a little being added to each; zeros elsewhere.
pub(super) fn inverse_over_free(
    unknowns: &[Unknown],
    information: &DMatrix<f64>,
    ridge: f64,
) -> Option<DMatrix<f64>> {
    inverse_over(&free(unknowns), information, ridge)
}

/// The same over these unknowns.
pub(super) fn inverse_over(
    indices: &[usize],
    information: &DMatrix<f64>,
    ridge: f64,
) -> Option<DMatrix<f64>> {
    let mut matrix = submatrix(information, indices);
    (0..indices.len()).for_each(|i| matrix[(i, i)] += ridge);
    let small = Cholesky::new(matrix)?.inverse();
    let mut whole = DMatrix::zeros(information.nrows(), information.nrows());
    for (i, to_i) in indices.iter().enumerate() {
        for (j, to_j) in indices.iter().enumerate() {
            whole[(*to_i, *to_j)] = small[(i, j)];
        }
    }
    Some(whole)
}

/// The rows and columns of these indices.
pub(super) fn submatrix(matrix: &DMatrix<f64>, indices: &[usize]) -> DMatrix<f64> {
    DMatrix::from_fn(indices.len(), indices.len(), |i, j| matrix[(indices[i], indices[j])])
}

/// A quadratic over some unknowns that is left when others follow.
pub(super) fn eliminate(
    information: &DMatrix<f64>,
    downhill: &DVector<f64>,
    kept: &[usize],
    others: &[usize],
) -> (DMatrix<f64>, DVector<f64>) {
    let inner = submatrix(information, kept);
    let part =
        |indices: &[usize]| DVector::from_iterator(indices.len(), indices.iter().map(|i| downhill[*i]));
    let mixed = DMatrix::from_fn(others.len(), kept.len(), |i, k| information[(others[i], kept[k])]);
    let ridge = DMatrix::identity(others.len(), others.len()) * 1e-9;
    match Cholesky::new(submatrix(information, others) + ridge) {
        Some(root) if !others.is_empty() => (
            inner - mixed.transpose() * root.solve(&mixed),
            part(kept) - mixed.transpose() * root.solve(&part(others)),
        ),
        _ => (inner, part(kept)),
    }
}
