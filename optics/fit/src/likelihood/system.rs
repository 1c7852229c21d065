//! Evaluates profiles that share unknowns: −2 ln L of all of them together, and its quadratic.

pub(crate) mod minimum;
pub(crate) mod part;
pub(crate) mod priors;
pub(crate) mod quantity;
pub(crate) mod settle;
pub(crate) mod unknowns;

use nalgebra::{DMatrix, DVector};
use optics_model::descent::DescentEnd;
use rayon::prelude::*;

use crate::likelihood::point::{LN_ONE_MINUS_G, LN_SIGMA_T, Line, Point};
use crate::likelihood::term::reduced::Reduced;
use crate::likelihood::term::{Linear, Term};
use crate::surrogate::Surrogate;
use quantity::Quantity;
use unknowns::{SceneUnknown, Unknown, Unknowns, free, inverse_over_free};

/// Tolerances of −2 ln L: of a start that is refined later, and of an estimate, which is then off by at most 1 % of its
/// standard error.
pub(crate) const COARSE: f64 = 0.5;
pub(crate) const FINE: f64 = 1e-4;
/// Most steps of a descent, which none should need.
pub(crate) const MOST_STEPS: usize = 400;
/// Number of terms from which on other threads are worth waking.
const MANY: usize = 4;

/// The likelihood of other measurements, as a quadratic in the unknowns about a centre.
#[derive(Debug, Clone)]
pub(crate) struct Coupling {
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

/// Profiles, each with the slots of its shared unknowns. For profiles of mixtures the unknowns of the medium follow from
/// inks.
#[derive(Debug, Clone)]
pub(crate) struct System<'a> {
    pub terms: Vec<Term>,
    pub surrogates: Vec<&'a Surrogate<'a>>,
    pub slots: Vec<Vec<usize>>,
    pub unknowns: Vec<Unknown>,
    /// The unknowns that are quantities of the scene.
    pub of_scene: Vec<SceneUnknown>,
    pub coupling: Option<Coupling>,
    /// Most steps of a descent.
    pub most_steps: usize,
}

/// Values of all unknowns, and −2 ln L there.
#[derive(Debug, Clone)]
pub(crate) struct State {
    pub x: DVector<f64>,
    /// Each profile's own unknowns.
    pub own: Vec<Line>,
    pub cost: f64,
    /// How the descent to it ended.
    pub end: DescentEnd,
}

/// Half of the second derivative and −½ of the gradient of −2 ln L; profiles' own unknowns are eliminated.
#[derive(Debug)]
pub(crate) struct Normal {
    pub information: DMatrix<f64>,
    pub downhill: DVector<f64>,
    pub reduced: Vec<Reduced>,
}

impl<'a> System<'a> {
    /// The system of profiles, each with its surrogate and the slots of its shared unknowns, and the state at which all
    /// unknowns have their initial values.
    pub(crate) fn new(
        profiles: Vec<(Term, &'a Surrogate<'a>, Vec<usize>)>,
        unknowns: Unknowns,
        of_scene: Vec<SceneUnknown>,
    ) -> (Self, State) {
        let own = profiles.iter().map(|(term, ..)| vec![0.0; term.own_count()]).collect();
        let state = State::new(DVector::from_vec(unknowns.x), own);
        let (mut terms, mut surrogates, mut slots) = (Vec::new(), Vec::new(), Vec::new());
        for (term, surrogate, of_term) in profiles {
            terms.push(term);
            surrogates.push(surrogate);
            slots.push(of_term);
        }
        let unknowns = unknowns.all;
        (Self { terms, surrogates, slots, unknowns, of_scene, coupling: None, most_steps: MOST_STEPS }, state)
    }
}

impl State {
    /// A state whose cost is not known yet, and to which no descent has led.
    pub(crate) fn new(x: DVector<f64>, own: Vec<Line>) -> Self {
        Self { x, own, cost: f64::INFINITY, end: DescentEnd::default() }
    }
}

impl System<'_> {
    pub(crate) fn point(&self, term: usize, x: &DVector<f64>) -> Point {
        let slots = &self.slots[term];
        match &self.terms[term].blend {
            None => Point(slots.iter().map(|slot| x[*slot]).collect()),
            Some(blend) => Point(blend.place(slots, x).point),
        }
    }

    /// This system with normal pixels and a dictionary without noise.
    pub(crate) fn ideal(&self) -> Self {
        let mut ideal = self.clone();
        for term in &mut ideal.terms {
            term.modes.clear();
            term.rest_variances.clear();
            term.robust = false;
        }
        ideal
    }

    /// Indices of the unknowns that can move.
    pub(crate) fn free(&self) -> Vec<usize> {
        free(&self.unknowns)
    }

    /// All profiles at a state.
    pub(crate) fn linear(&self, x: &DVector<f64>, own: &[Line]) -> Vec<Linear> {
        let one = |i: usize| self.terms[i].linear(self.surrogates[i], &self.point(i, x), &own[i]);
        if self.terms.len() < MANY {
            (0..self.terms.len()).map(one).collect()
        } else {
            (0..self.terms.len()).into_par_iter().map(one).collect()
        }
    }

    fn cost(&self, x: &DVector<f64>, linear: &[Linear]) -> f64 {
        linear.iter().map(|l| l.cost).sum::<f64>() + self.prior_cost(x)
    }

    /// −2 ln L at a state, and its quadratic there.
    pub(crate) fn look(&self, state: &State) -> (f64, Normal) {
        let linear = self.linear(&state.x, &state.own);
        (self.cost(&state.x, &linear), self.normal(&state.x, &state.own, &linear))
    }

    /// Computes the predictions near the thicknesses, and the responses to the white reference, wedges and the scene,
    /// again at the current media.
    pub(crate) fn move_near(&mut self, x: &DVector<f64>) {
        let points: Vec<Point> = (0..self.terms.len()).map(|i| self.point(i, x)).collect();
        let each = self.terms.par_iter_mut().zip(&self.surrogates).zip(&points);
        each.for_each(|((term, surrogate), point)| {
            term.near = surrogate.near(term.thickness_mm, point.medium());
            if term.responses.is_some() {
                term.responses = surrogate.responses(point.thickness_mm(), point.medium());
            }
            term.move_wedge(surrogate, point.thickness_mm(), point.medium());
            let white = term.white.as_ref();
            term.white = white.and_then(|w| w.moved(surrogate, point.thickness_mm(), point.medium()));
        });
    }

    pub(crate) fn normal(&self, x: &DVector<f64>, own: &[Line], linear: &[Linear]) -> Normal {
        let one = |i: usize| self.terms[i].reduce(&linear[i], &own[i]);
        let reduced: Vec<Reduced> = if linear.len() < MANY {
            (0..linear.len()).map(one).collect()
        } else {
            (0..linear.len()).into_par_iter().map(one).collect()
        };
        self.sum(x, reduced)
    }

    /// The sum over all profiles, priors and the coupling.
    fn sum(&self, x: &DVector<f64>, reduced: Vec<Reduced>) -> Normal {
        let n = self.unknowns.len();
        let (mut information, mut downhill) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (i, reduced) in reduced.iter().enumerate() {
            self.add_reduced(i, x, reduced, &mut information, &mut downhill);
        }
        (0..n).for_each(|i| self.add_prior(i, x, &mut information, &mut downhill));
        if let Some(coupling) = &self.coupling {
            downhill += &coupling.downhill - &coupling.information * (x - &coupling.centre);
            information += &coupling.information;
        }
        Normal { information, downhill, reduced }
    }

    /// Adds a profile's information on the unknowns, and its pull.
    pub(crate) fn add_reduced(
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

    /// Whether an extinction or an anisotropy, other than the quantity itself, lies at a limit of the dictionary or of
    /// the bounds and would move beyond it by more than its standard deviation; or, for an absorption, whether an albedo
    /// lies at a limit.
    pub(crate) fn at_end(&self, state: &State, quantity: Quantity) -> bool {
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

    /// The inverse of an information matrix over the unknowns that can move; zeros elsewhere. None if it is singular.
    pub(crate) fn covariance(&self, information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        inverse_over_free(&self.unknowns, information, 0.0)
    }
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
}
