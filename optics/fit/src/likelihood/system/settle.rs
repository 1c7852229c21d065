//! Leads a system from a first minimum to the final one: adds the noise of the records, and leaves out dust.

use nalgebra::{Cholesky, DVector};
use rayon::prelude::*;

use crate::likelihood::point::{Line, SHARED};
use crate::likelihood::system::unknowns::{submatrix, subvector};
use crate::likelihood::system::{COARSE, FINE};
use crate::likelihood::system::{State, System};
use crate::likelihood::term::Own;
use crate::likelihood::term::records_noise::Modes;
use crate::likelihood::term::robust::without_specks;
use crate::likelihood::term::robust::{is_dust, specks};
use crate::surrogate::{Coordinates, NoisePlace, Surrogate};

/// Greatest change of an unknown before the parts that depend on the state are computed again: a hundredth of σ_t, for
/// example.
const FAR: f64 = 0.01;
/// That change of a quantity of the scene, in standard deviations of its prior.
const FAR_OF_SCENE: f64 = 0.1;
/// Most times that they are computed again.
const MOVES: usize = 4;
/// Greatest distance, in mm, of an edge from its stated origin at which a descent finds it.
const FAR_MM: f64 = 0.06;
/// Factor by which the noise is reduced at a time, on the way to a model without dust.
const HARDER: f64 = 0.4;

impl<'a> System<'a> {
    /// A first minimum by a descent from a state, without the noise of records: specks are left out, and edges are
    /// located.
    pub(crate) fn approach(&mut self, mut state: State, tolerance: f64) -> State {
        self.leave_out_specks_by_neighbours();
        self.place_edges(&mut state);
        self.descend(state, None, tolerance)
    }

    /// Descends from a rough minimum to the final one: with the noise of the neighbouring records, and without dust.
    pub(crate) fn settle(&mut self, mut state: State) -> State {
        self.add_modes(&mut state);
        let mut modes_at = state.clone();
        for term in &mut self.terms {
            term.robust = true;
            term.left_out.fill(false);
        }
        // Dust biases a first model, and cannot be identified before the model is good: so the noise is first set to the
        // size of most residuals, and then reduced step by step.
        let mut softness = f64::INFINITY;
        while softness > 1.0 {
            softness = (HARDER * softness).min(self.typical_residual(&state)).max(1.0);
            self.terms.iter_mut().for_each(|term| term.softness = softness);
            state = self.descend(state, None, COARSE);
        }
        for _ in 0..2 {
            let changed = self.leave_out_specks(&state);
            state = self.descend(state, None, FINE);
            if !changed {
                break;
            }
        }
        // The noise of the responses grows with the quantities of the scene, and responses follow a medium to first order.
        for _ in 0..MOVES {
            if !self.is_far(&state, &modes_at) {
                break;
            }
            modes_at = state.clone();
            self.add_modes(&mut state);
            state = self.descend(state, None, FINE);
        }
        state
    }

    /// Whether an unknown has moved far from where the parts that depend on the state were computed.
    fn is_far(&self, state: &State, from: &State) -> bool {
        let is_of_scene = |i: usize| self.of_scene.iter().any(|unknown| unknown.slot == i);
        let far = |i: usize| if is_of_scene(i) { FAR_OF_SCENE } else { FAR };
        (0..state.x.len()).any(|i| (state.x[i] - from.x[i]).abs() > far(i))
    }

    /// The state with some unknowns moved and held there, the others following in one step.
    pub(crate) fn held_at(&self, state: &State, places: &[(usize, f64)]) -> State {
        let mut x: DVector<f64> = state.x.clone();
        for (i, value) in places {
            x[*i] = *value;
        }
        let others: Vec<usize> =
            self.free().into_iter().filter(|i| places.iter().all(|(held, _)| held != i)).collect();
        let linear = self.linear(&x, &state.own);
        let normal = self.normal(&x, &state.own, &linear);
        let mut there = State { x, ..state.clone() };
        let mut step = DVector::zeros(there.x.len());
        if let Some(root) = Cholesky::new(submatrix(&normal.information, &others)) {
            let pull = subvector(&normal.downhill, &others);
            others.iter().zip(root.solve(&pull).iter()).for_each(|(i, s)| step[*i] = *s);
        }
        self.advance(&mut there, &normal, &step);
        there
    }

    /// Leaves out pixels that deviate from their neighbours, before there is a model.
    fn leave_out_specks_by_neighbours(&mut self) {
        for term in &mut self.terms {
            term.left_out = without_specks(&term.values, &term.std_errors).iter().map(|c| !c).collect();
        }
    }

    /// Searches along each profile for its edge, if it may lie so far off that a descent would not find it.
    fn place_edges(&self, state: &mut State) {
        for (i, (term, own)) in self.terms.iter().zip(&mut state.own).enumerate() {
            let origin = term.priors.iter().position(|p| p.own == Own::Origin && p.std_error > FAR_MM);
            let Some(origin) = origin else { continue };
            let point = self.point(i, &state.x);
            let steps = (2.5 * term.priors[origin].std_error / FAR_MM).ceil() as i32;
            let cost = |step: i32| {
                let mut there = own.clone();
                there[origin] = f64::from(step) * FAR_MM / term.priors[origin].std_error;
                (term.linear(self.surrogates[i], &point, &there).cost, there)
            };
            let best = (-steps..=steps).map(cost).min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, there)) = best {
                *own = there;
            }
        }
    }

    /// Updates the parts of every profile that depend on the state: the records' noise, and those of `move_near`.
    pub(crate) fn add_modes(&mut self, state: &mut State) {
        self.move_near(&state.x);
        let places: Vec<NoisePlace> = self.places_of(Surrogate::noise_at, state);
        let alike = |i: usize| places.iter().map(|other| places[i].in_common(other)).sum();
        let alike: Vec<f64> = (0..self.terms.len()).map(alike).collect();
        let of_responses = self.response_factors(state, &alike);
        let modes = |(i, of_responses): (usize, Vec<Line>)| {
            let (term, point) = (&self.terms[i], self.point(i, &state.x));
            let mut noise = self.surrogates[i].noise_factors_at(point.thickness_mm(), point.medium());
            noise.factors.extend(of_responses);
            noise
                .factors
                .extend(term.model_errors(&point, self.surrogates[i].grid().scene().sensor().width_mm()));
            let origin = term.origin_mm(&state.own[i]);
            Modes::new(&noise, &term.camera, origin, &term.std_errors)
        };
        let found: Vec<Modes> = of_responses.into_par_iter().enumerate().map(modes).collect();
        for (i, ((term, own), found)) in self.terms.iter_mut().zip(&mut state.own).zip(found).enumerate() {
            own.truncate(term.priors.len());
            own.resize(term.priors.len() + found.modes.len(), 0.0);
            (term.modes, term.rest_variances, term.alike) = (found.modes, found.rest_variances, 1.0);
            term.count_alike(own, alike[i]);
        }
    }

    /// The values of a function at every profile's medium and thickness.
    fn places_of<T: Send>(
        &self,
        of: impl Fn(&Surrogate<'a>, f64, Coordinates) -> T + Sync,
        state: &State,
    ) -> Vec<T> {
        let place = |i: usize| {
            let point = self.point(i, &state.x);
            of(self.surrogates[i], point.thickness_mm(), point.medium())
        };
        (0..self.terms.len()).into_par_iter().map(place).collect()
    }

    /// The noise of the responses in every profile, as factors of its covariance. All modes of a profile are counted as
    /// those of `alike` profiles: these factors are scaled to count as those of the profiles that share a quantity
    /// instead.
    fn response_factors(&self, state: &State, alike: &[f64]) -> Vec<Vec<Line>> {
        if self.of_scene.is_empty() {
            return vec![Vec::new(); self.terms.len()];
        }
        let noises = self.places_of(Surrogate::response_noise, state);
        let quantity_factors = |i: usize, prior: usize, slot: usize| -> Vec<Line> {
            let Some(noise) = &noises[i] else { return Vec::new() };
            let sharing = (0..noises.len()).filter(|k| self.slots[*k].contains(&slot));
            let others = sharing.filter_map(|k| noises[k].as_ref());
            let common: f64 = others.map(|other| noise.place.in_common(&other.place)).sum();
            let size = (common / alike[i]).sqrt();
            let mut factors = noise.factors(prior, state.x[slot]);
            factors.iter_mut().flatten().for_each(|v| *v *= size);
            factors
        };
        let term_factors = |i: usize| {
            let slots = self.slots[i].iter().skip(SHARED).enumerate();
            slots.flat_map(|(prior, slot)| quantity_factors(i, prior, *slot)).collect()
        };
        (0..self.terms.len()).into_par_iter().map(term_factors).collect()
    }

    /// Robust standard deviation of the residuals over the noise, from the median of their magnitudes: the greatest of
    /// all profiles.
    fn typical_residual(&self, state: &State) -> f64 {
        let linear = self.linear(&state.x, &state.own);
        let median = |residuals: &Line| {
            let mut sizes: Line = residuals.iter().map(|r| r.abs()).collect();
            sizes.sort_by(f64::total_cmp);
            1.4826 * sizes[sizes.len() / 2]
        };
        linear.iter().map(|l| median(&l.residuals)).fold(0.0, f64::max)
    }

    /// Leaves out the pixels that are dust; false if nothing changed.
    fn leave_out_specks(&mut self, state: &State) -> bool {
        let linear = self.linear(&state.x, &state.own);
        let mut changed = false;
        for (term, linear) in self.terms.iter_mut().zip(linear) {
            let found = specks(&linear.residuals);
            let dusty = is_dust(&found);
            let left_out = if dusty { found } else { vec![false; linear.residuals.len()] };
            changed |= left_out != term.left_out || dusty != term.robust;
            (term.left_out, term.robust) = (left_out, dusty);
        }
        changed
    }
}
