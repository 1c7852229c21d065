//! Chooses albedos at which the levels of walks are compared with exact ones, and interpolates the differences.
//!
//! A level is the radiance factor over a uniform base, which a profile reaches far from the edge. Walks of a finite number
//! give it as L, a solver of plane layers as U. For any weights w the mean of Σ w (U − L) over a few albedos is 0, so
//! adding it to a record changes no mean; with weights that interpolate between neighbours it removes nearly all noise
//! that the record shares with its levels.

use crate::job::JobSpec;
use crate::phase::PhaseShape;

/// Narrowest peak of a phase function for which levels are computed: 1 − |g| of a lobe.
pub const NARROWEST_PEAK: f64 = 0.04;

/// Between these the noise of levels is nearly linear in √(1 − α): 1 to 4 % of its variance is left.
const ALBEDOS: [f64; 9] = [0.0, 0.3439, 0.64, 0.84, 0.9375, 0.9804, 0.9951, 0.9991, 1.0];

/// The albedos at which a job's levels are compared, and the weights of two of them for each of its own.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Controls {
    albedos: Vec<f64>,
    weights: Vec<[(usize, f64); 2]>,
}

impl Controls {
    /// None of a job whose levels are not computed, see [`NARROWEST_PEAK`].
    pub fn of_job(job: &JobSpec) -> Self {
        if !is_computed(job.scene().phase(), job.point().g()) {
            return Self::default();
        }
        let places: Vec<[(usize, f64); 2]> = job.albedo().iter().map(|albedo| weights(*albedo)).collect();
        let is_used = |k: &usize| places.iter().flatten().any(|(place, weight)| place == k && *weight > 0.0);
        let used: Vec<usize> = (0..ALBEDOS.len()).filter(is_used).collect();
        let number =
            |(place, weight): (usize, f64)| (used.iter().position(|k| *k == place).unwrap_or(0), weight);
        Self {
            albedos: used.iter().map(|k| ALBEDOS[*k]).collect(),
            weights: places.iter().map(|pair| pair.map(number)).collect(),
        }
    }

    pub fn albedos(&self) -> &[f64] {
        &self.albedos
    }

    pub fn is_empty(&self) -> bool {
        self.albedos.is_empty()
    }

    /// Σ w v for one of the job's albedos, from the values v at [`Self::albedos`].
    pub fn at(&self, albedo: usize, values: &[f64]) -> f64 {
        self.weights[albedo].iter().map(|(place, weight)| weight * values[*place]).sum()
    }
}

/// Whether levels are computed for a phase function of this mean cosine, see [`NARROWEST_PEAK`].
pub fn is_computed(phase: &PhaseShape, g: f64) -> bool {
    phase.function_near(g).peak_width() >= NARROWEST_PEAK * (1.0 - 1e-9)
}

/// Two neighbouring albedos, with weights linear in √(1 − α).
fn weights(albedo: f64) -> [(usize, f64); 2] {
    let root = |albedo: f64| (1.0 - albedo).max(0.0).sqrt();
    let above = ALBEDOS.partition_point(|a| *a < albedo).clamp(1, ALBEDOS.len() - 1);
    let [far, near] = [above - 1, above].map(|k| root(ALBEDOS[k]));
    let share = ((far - root(albedo)) / (far - near)).clamp(0.0, 1.0);
    [(above - 1, 1.0 - share), (above, share)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::{TransportPoint, Walks};

    fn controls(g: f64, albedo: Vec<f64>) -> Controls {
        let point = TransportPoint::new(2.0, g, 0.5, 1.53).unwrap();
        Controls::of_job(&JobSpec::new(Scene::paper(), point, albedo, Walks::PAPER, 1, false).unwrap())
    }

    /// A function that is linear in √(1 − α) between neighbours is interpolated exactly, at any albedo.
    #[test]
    fn linear_functions_are_exact() {
        let albedo = vec![0.0, 0.2, 0.35, 0.9375, 0.99, 0.99999, 1.0];
        let controls = controls(0.4, albedo.clone());
        let value = |albedo: f64| 3.0 - 2.0 * (1.0 - albedo).sqrt();
        let values: Vec<f64> = controls.albedos().iter().map(|a| value(*a)).collect();
        for (i, albedo) in albedo.iter().enumerate() {
            assert!((controls.at(i, &values) - value(*albedo)).abs() < 1e-12, "{albedo}");
        }
    }

    /// Only albedos with a weight are computed, and none under a peak that the solver does not resolve.
    #[test]
    fn only_neighbours_are_computed() {
        assert_eq!(controls(0.4, vec![0.9375]).albedos(), [0.9375]);
        assert_eq!(controls(0.4, vec![0.99]).albedos(), [0.9804, 0.9951]);
        assert_eq!(controls(0.96, vec![1.0]).albedos(), [1.0]);
        assert!(controls(0.97, vec![1.0]).is_empty());
    }
}
