//! Evaluates the priors of the unknowns: their −2 ln L, information and pull.

use nalgebra::{DMatrix, DVector};

use crate::likelihood::system::System;
use crate::likelihood::system::unknowns::SceneUnknown;

/// Standard deviations up to which the prior of a quantity of the scene is normal.
const FIRM: f64 = 2.0;

impl System<'_> {
    /// −2 ln L of all priors and of the coupling.
    pub(crate) fn prior_cost(&self, x: &DVector<f64>) -> f64 {
        let priors = (0..self.unknowns.len()).filter_map(|i| self.cost_of_prior(i, x));
        priors.sum::<f64>() + self.coupling.as_ref().map_or(0.0, |c| c.cost(x))
    }

    /// −2 ln L of an unknown's prior; None if it has none or cannot move.
    pub(crate) fn cost_of_prior(&self, slot: usize, x: &DVector<f64>) -> Option<f64> {
        let (off, _) = self.off_prior(slot, x)?;
        Some(prior_cost(self.prior_weight(slot, off), off))
    }

    /// Distance of an unknown from the mean of its prior in standard deviations, and the standard deviation.
    fn off_prior(&self, slot: usize, x: &DVector<f64>) -> Option<(f64, f64)> {
        let unknown = &self.unknowns[slot];
        let (mean, sd) = unknown.prior.filter(|_| !unknown.held)?;
        let about = unknown.about.map_or(0.0, |of_mean| x[of_mean]);
        Some(((x[slot] - mean - about) / sd, sd))
    }

    /// Weight of a prior at `off` standard deviations. Priors of the scene's quantities are rough guesses, if the
    /// session has not measured them: beyond [`FIRM`] they pull no harder, so that data that contradict them are
    /// followed.
    fn prior_weight(&self, slot: usize, off: f64) -> f64 {
        if self.of_scene(slot).is_some_and(|u| !u.is_measured) { rough_weight(off) } else { 1.0 }
    }

    /// The quantity of the scene that an unknown is, or is the mean of over slabs.
    pub(crate) fn of_scene(&self, slot: usize) -> Option<&SceneUnknown> {
        let is = |of: &&SceneUnknown| of.slot == slot || self.unknowns[of.slot].about == Some(slot);
        self.of_scene.iter().find(is)
    }

    /// Adds the information of an unknown's prior, and its pull.
    pub(crate) fn add_prior(
        &self,
        slot: usize,
        x: &DVector<f64>,
        information: &mut DMatrix<f64>,
        downhill: &mut DVector<f64>,
    ) {
        let Some((off, sd)) = self.off_prior(slot, x) else { return };
        let weight = self.prior_weight(slot, off);
        let (of_prior, pull) = (weight / (sd * sd), weight * off / sd);
        information[(slot, slot)] += of_prior;
        downhill[slot] -= pull;
        if let Some(mean) = self.unknowns[slot].about {
            information[(mean, mean)] += of_prior;
            information[(slot, mean)] -= of_prior;
            information[(mean, slot)] -= of_prior;
            downhill[mean] += pull;
        }
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
    use crate::likelihood::system::unknowns::{OF_MEAN, Unknowns};

    /// A quantity of two slabs, without profiles: their mean and the two values.
    fn two_slabs() -> System<'static> {
        let anywhere = (f64::NEG_INFINITY, f64::INFINITY);
        let mut unknowns = Unknowns::default();
        let mean = unknowns.known((0.0, OF_MEAN), anywhere);
        let of_scene = [0.5, 1.0].map(|slab_mm| SceneUnknown {
            prior: 0,
            material: Some(0),
            slab_mm: Some(slab_mm),
            channel: None,
            is_measured: false,
            slot: unknowns.about(mean, OF_MEAN, anywhere),
        });
        System::new(Vec::new(), unknowns, of_scene.to_vec()).0
    }

    fn information(system: &System, x: &DVector<f64>) -> (DMatrix<f64>, DVector<f64>) {
        let (mut information, mut downhill) = (DMatrix::zeros(3, 3), DVector::zeros(3));
        (0..3).for_each(|slot| system.add_prior(slot, x, &mut information, &mut downhill));
        (information, downhill)
    }

    /// Values of slabs have the standard deviation of the prior and a correlation of ½.
    #[test]
    fn slabs_are_correlated() {
        let system = two_slabs();
        let covariance = system.covariance(&information(&system, &DVector::zeros(3)).0).unwrap();
        for (place, expected) in [((1, 1), 1.0), ((2, 2), 1.0), ((1, 2), 0.5), ((0, 0), 0.5)] {
            assert!((covariance[place] - expected).abs() < 1e-12, "{place:?}: {}", covariance[place]);
        }
    }

    /// Pulls are −½ of the slopes of the cost, also where a slab lies far from the mean.
    #[test]
    fn pulls_are_slopes_of_the_cost() {
        let (system, x) = (two_slabs(), DVector::from_row_slice(&[1.7, 1.2, 4.0]));
        let (_, downhill) = information(&system, &x);
        for slot in 0..3 {
            let cost = |step: f64| {
                let mut x = x.clone();
                x[slot] += step;
                system.prior_cost(&x)
            };
            let slope = (cost(1e-6) - cost(-1e-6)) / 2e-6;
            assert!((slope + 2.0 * downhill[slot]).abs() < 1e-6, "{slot}: {slope}, {}", downhill[slot]);
        }
    }

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
