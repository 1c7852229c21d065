//! Evaluates the priors of the unknowns: their −2 ln L, information and pull.

use nalgebra::DVector;

use crate::likelihood::system::System;

/// Standard deviations up to which the prior of a quantity of the scene is normal.
const FIRM: f64 = 2.0;

impl System<'_> {
    /// −2 ln L of all priors and of the coupling.
    pub(crate) fn prior_cost(&self, x: &DVector<f64>) -> f64 {
        let priors = (0..self.unknowns.len()).filter_map(|i| self.cost_of_prior(i, x[i]));
        priors.sum::<f64>() + self.coupling.as_ref().map_or(0.0, |c| c.cost(x))
    }

    /// −2 ln L of an unknown's prior at `x`; None if it has none or cannot move.
    pub(crate) fn cost_of_prior(&self, slot: usize, x: f64) -> Option<f64> {
        let unknown = &self.unknowns[slot];
        let (mean, sd) = unknown.prior.filter(|_| !unknown.held)?;
        let off = (x - mean) / sd;
        Some(prior_cost(self.prior_weight(slot, off), off))
    }

    /// Weight of a prior at `off` standard deviations. Priors of the scene's quantities are rough guesses: beyond
    /// [`FIRM`] they pull no harder, so that data that contradict them are followed.
    fn prior_weight(&self, slot: usize, off: f64) -> f64 {
        if self.of_scene.iter().any(|u| u.slot == slot) { rough_weight(off) } else { 1.0 }
    }

    /// Information of an unknown's prior, and its pull at `x`; zeros without one.
    pub(crate) fn prior_pull(&self, slot: usize, x: f64) -> (f64, f64) {
        let unknown = &self.unknowns[slot];
        let Some((mean, sd)) = unknown.prior.filter(|_| !unknown.held) else { return (0.0, 0.0) };
        let weight = self.prior_weight(slot, (x - mean) / sd);
        (weight / (sd * sd), -weight * (x - mean) / (sd * sd))
    }
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

    /// A rough prior is normal up to two standard deviations; then its cost is 4 |u| − 4, with a slope that equals its
    /// pull.
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
