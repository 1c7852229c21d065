//! Keeps all channels of a set at their common minimum, and extracts each of them as a separate system.

use nalgebra::{Cholesky, DMatrix, DVector};
use optics_model::fit::Interval;

use crate::likelihood::interval::chi2::exceedance;
use crate::likelihood::interval::profile_likelihood::{ProfileLikelihood, interval};
use crate::likelihood::point::{LN_ONE_MINUS_G, LN_SCALE};
use crate::likelihood::problem::assembly::{Assembly, Sharing};
use crate::likelihood::system::FINE;
use crate::likelihood::system::part::slot_in;
use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::unknowns::eliminate;
use crate::likelihood::system::{Normal, State, System};
use crate::surrogate::g;

/// Probability of the channels' pulls below which they count as contradictory.
const DISAGREE: f64 = 0.01;

/// Standard deviation of the prior of the materials' spread of ln(1 − g), and the number of values of the spread that are
/// tried.
pub(super) const SPREAD: f64 = 0.1;
const SPREADS: u32 = 80;
/// Added to the information on ln(1 − g) of a material, which the data may not determine.
const LEAST_INFORMATION: f64 = 1e-3;

/// All channels at their common minimum.
pub(super) struct Joint<'a> {
    pub assembly: Assembly<'a>,
    pub state: State,
    pub normal: Normal,
    pub covariance: Option<DMatrix<f64>>,
    pub iors: Vec<usize>,
    /// χ² per degree of freedom of the channels' pulls on the shared unknowns, but at least 1.
    pub disagreement: f64,
    /// Slots of the unknowns that all channels share.
    pub common: Vec<usize>,
}

impl<'a> Joint<'a> {
    /// Whether all channels have an unknown.
    pub(super) fn is_common(&self, slot: usize) -> bool {
        self.common.contains(&slot)
    }

    pub(super) fn deviation(&self, slot: usize) -> f64 {
        let variance = self.covariance.as_ref().map_or(f64::INFINITY, |c| c[(slot, slot)]);
        (variance * self.disagreement).max(0.0).sqrt()
    }

    /// ln(1 − g) of the materials by the data alone, without the prior of their differences, and the information on them:
    /// from the quadratic about the minimum.
    fn g_of_materials(&self) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let (mean, slots) = self.assembly.g_of_materials.as_ref()?;
        let system = &self.assembly.system;
        let (mut information, mut downhill) = (self.normal.information.clone(), self.normal.downhill.clone());
        let n = downhill.len();
        let (mut of_priors, mut pull) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for slot in slots {
            system.add_prior(*slot, &self.state.x, &mut of_priors, &mut pull);
        }
        information -= of_priors;
        downhill -= pull;
        let is_other = |i: &usize| i != mean && !slots.contains(i);
        let others: Vec<usize> = system.free().into_iter().filter(is_other).collect();
        let (mut information, downhill) = eliminate(&information, &downhill, slots, &others);
        (0..slots.len()).for_each(|i| information[(i, i)] += LEAST_INFORMATION);
        let at = DVector::from_iterator(slots.len(), slots.iter().map(|slot| self.state.x[*slot]));
        let x = at + Cholesky::new(information.clone())?.solve(&downhill);
        Some((x, information / self.disagreement))
    }

    /// Probability that media of one g make the estimates of the materials differ as much: χ² of their distances from the
    /// best common value.
    pub(super) fn g_equal_probability(&self) -> Option<f64> {
        let (x, information) = self.g_of_materials()?;
        let (chi2, _) = about_mean(&x, &information);
        Some(exceedance(chi2, (x.len() - 1) as f64))
    }

    /// Standard deviation of ln(1 − g) of the materials about their mean: the root of the mean of its square over its
    /// distribution given the data, from a normal prior of [`SPREAD`].
    pub(super) fn g_spread(&self) -> Option<f64> {
        let (x, information) = self.g_of_materials()?;
        let covariance = Cholesky::new(information)?.inverse();
        let weight = |spread: f64| -> Option<f64> {
            let with = &covariance + DMatrix::identity(x.len(), x.len()) * (spread * spread);
            let root = Cholesky::new(with)?;
            let (chi2, total) = about_mean(&x, &root.inverse());
            let ln_weight =
                -0.5 * (root.ln_determinant() + libm::log(total) + chi2 + (spread / SPREAD).powi(2));
            Some(ln_weight)
        };
        let spreads = (0..SPREADS).map(|i| (f64::from(i) + 0.5) * 4.0 * SPREAD / f64::from(SPREADS));
        let found: Vec<(f64, f64)> = spreads.filter_map(|s| Some((s, weight(s)?))).collect();
        let most = found.iter().map(|(_, w)| *w).fold(f64::NEG_INFINITY, f64::max);
        let (mut sum, mut squares) = (0.0, 0.0);
        for (spread, ln_weight) in found {
            let weight = libm::exp(ln_weight - most);
            (sum, squares) = (sum + weight, squares + weight * spread * spread);
        }
        (sum > 0.0).then(|| (squares / sum).sqrt())
    }

    pub(super) fn g_interval(&self, slot: usize) -> Interval {
        let limits = self.assembly.system.unknowns[slot].limits;
        let Some(covariance) = &self.covariance else {
            return Interval { low: g(limits.1), high: g(limits.0), open_low: true, open_high: true };
        };
        let profile = ProfileLikelihood {
            system: &self.assembly.system,
            optimum: &self.state,
            normal: &self.normal,
            covariance,
            inflation: self.disagreement,
        };
        interval(profile.ends(Quantity::Unknown(slot), limits), g, true)
    }

    /// A channel as a separate system, with the others as a quadratic.
    pub(super) fn channel(&self, channel: usize) -> (System<'a>, State) {
        let terms: Vec<usize> = self.assembly.terms[channel].clone().collect();
        let (whole, share) = (&self.assembly.system, 1.0 / self.disagreement);
        let (mut system, mut state) = whole.part(&terms, &self.state, &self.normal, share);
        // For the channel's own medium, noise that other profiles share counts once.
        system.terms.iter_mut().zip(&mut state.own).for_each(|(term, own)| term.count_alike(own, 1.0));
        let used = whole.used_by(&terms);
        let common: Vec<usize> = self.common.iter().map(|slot| slot_in(&used, *slot)).collect();
        let mut state = descend_with(&mut system, state, &common);
        state.end = state.end.max(self.state.end);
        (system, state)
    }

    /// This minimum with the disagreement of its channels.
    pub(super) fn with_disagreement(self) -> Self {
        Self { disagreement: self.found_disagreement(), ..self }
    }

    fn found_disagreement(&self) -> f64 {
        let unknowns = &self.assembly.system.unknowns;
        let shared = &self.common;
        let channels = self.assembly.terms.len();
        let freedom = (shared.len() * channels.saturating_sub(1)) as f64;
        if freedom == 0.0 {
            return 1.0;
        }
        let pull = |channel: usize| -> f64 {
            let terms: Vec<usize> = self.assembly.terms[channel].clone().collect();
            let system = &self.assembly.system;
            let (mut information, downhill) = system.contribution(&terms, &self.state, &self.normal);
            let mut of_priors = downhill.clone();
            let others: Vec<usize> = system
                .used_by(&terms)
                .into_iter()
                .filter(|i| !unknowns[*i].held && !shared.contains(i))
                .collect();
            for i in &others {
                system.add_prior(*i, &self.state.x, &mut information, &mut of_priors);
            }
            let (information, pull) = eliminate(&information, &downhill, shared, &others);
            let ridge = DMatrix::identity(shared.len(), shared.len()) * 1e-9;
            Cholesky::new(information + ridge).map_or(0.0, |c| pull.dot(&c.solve(&pull)))
        };
        let chi2: f64 = (0..channels).map(pull).sum();
        if exceedance(chi2, freedom) < DISAGREE { (chi2 / freedom).max(1.0) } else { 1.0 }
    }
}

/// Slots of the unknowns that all channels of an assembly share and the data determine.
pub(super) fn common_slots(system: &System, sharing: Sharing) -> Vec<usize> {
    // Anisotropies of a curve differ.
    let is_one = |i: usize| system.slots.iter().all(|slots| slots[i] == system.slots[0][i]);
    [(LN_ONE_MINUS_G, sharing.g && is_one(LN_ONE_MINUS_G)), (LN_SCALE, sharing.scale.is_some())]
        .into_iter()
        .filter(|(_, shared)| *shared)
        .map(|(i, _)| system.slots[0][i])
        .filter(|slot| !system.unknowns[*slot].held)
        .collect()
}

/// χ² of numbers about their best common value, and the information on that.
fn about_mean(x: &DVector<f64>, information: &DMatrix<f64>) -> (f64, f64) {
    let weights = information.column_sum();
    let away = x.add_scalar(-weights.dot(x) / weights.sum());
    (away.dot(&(information * &away)), weights.sum())
}

/// The minimum of a channel with the common unknowns held at their joint estimates.
///
/// A channel's own weights differ from those that it has among others, so that at the common values its gradient is not
/// zero. The coupling compensates the remaining gradient: the common values stay the minimum, and intervals begin there.
/// A gradient that pulls over an end of the dictionary stays, as in any descent.
fn descend_with(system: &mut System, from: State, common: &[usize]) -> State {
    let hold = |system: &mut System, held: bool| common.iter().for_each(|i| system.unknowns[*i].held = held);
    hold(system, true);
    let state = system.descend(from, None, FINE);
    hold(system, false);
    let (_, normal) = system.look(&state);
    let inwards = |i: &&usize| {
        let (low, high) = system.unknowns[**i].limits;
        let (x, downhill) = (state.x[**i], normal.downhill[**i]);
        !((x <= low && downhill < 0.0) || (x >= high && downhill > 0.0))
    };
    if let Some(coupling) = &mut system.coupling {
        common.iter().filter(inwards).for_each(|i| coupling.downhill[*i] -= normal.downhill[*i]);
    }
    state
}
