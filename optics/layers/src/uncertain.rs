//! A medium with its errors: those of its own, and those that it shares with other media and with the set-up.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use optics_model::Medium;
use optics_model::fit::SharedErrors;
use optics_model::phase::{MOST_G, MOST_SECOND_WEIGHT, PhaseShape, SecondLobe};

use crate::print::{Print, PrintLayer};

/// A medium with the covariance of (ln σ_t, √(1 − α), ln(1 − g)).
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertain {
    pub medium: Medium,
    pub second_lobe: SecondLobe,
    pub covariance: [[f64; 3]; 3],
    /// Changes of ln σ_t, √(1 − α), ln(1 − g), and of weight and anisotropy of the second lobe, by one standard deviation of
    /// each independent source of errors that it shares; `covariance` contains them.
    pub shared: Vec<[f64; SharedErrors::OF_MEDIUM]>,
}

/// Index of a number of the second lobe in the changes of a medium.
#[derive(Debug, Clone, Copy)]
enum OfLobe {
    Weight = 3,
    G = 4,
}

/// The slopes of a function of a medium.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slopes {
    medium: Vector3<f64>,
    /// In weight and anisotropy of the second lobe.
    lobe: [f64; 2],
}

/// Half of the difference of both ends; where one end is at a limit of the medium, such as an albedo of 1, the other
/// counts.
fn change(up: f64, down: f64, value: f64) -> f64 {
    match () {
        () if down == value => up - value,
        () if up == value => value - down,
        () => 0.5 * (up - down),
    }
}

/// Directions of one standard deviation: the roots of a covariance's eigenvalues along its eigenvectors.
fn directions(covariance: &Matrix3<f64>) -> [Vector3<f64>; 3] {
    let eigen = SymmetricEigen::new(*covariance);
    std::array::from_fn(|i| eigen.eigenvectors.column(i) * eigen.eigenvalues[i].max(0.0).sqrt())
}

/// dᵀ C⁻¹ d in the directions in which a covariance is not 0, and their number; None if there are none.
pub fn chi2(difference: &[f64; 3], covariance: impl Fn(usize, usize) -> f64) -> Option<(f64, usize)> {
    /// Share of the greatest variance that counts as 0.
    const NONE: f64 = 1e-12;
    let eigen = SymmetricEigen::new(Matrix3::from_fn(covariance));
    let least = NONE * eigen.eigenvalues.max();
    let difference = Vector3::from(*difference);
    let kept: Vec<f64> = (0..3)
        .filter(|i| eigen.eigenvalues[*i] > least)
        .map(|i| eigen.eigenvectors.column(i).dot(&difference).powi(2) / eigen.eigenvalues[i])
        .collect();
    (!kept.is_empty()).then(|| (kept.iter().sum(), kept.len()))
}

impl Uncertain {
    /// A medium without errors.
    pub fn exact(medium: Medium, second_lobe: SecondLobe) -> Self {
        Self { medium, second_lobe, covariance: [[0.0; 3]; 3], shared: Vec::new() }
    }

    /// A function of the medium, and the standard error that the medium's errors give it.
    pub fn spread(&self, f: impl Fn(&Self) -> f64) -> (f64, f64) {
        let value = f(self);
        let moved: Vec<Self> = self.moved_both_ways().into_iter().flatten().collect();
        let ends: Vec<f64> = moved.iter().map(f).collect();
        let slopes = self.slopes(value, &ends);
        let squares = |changes: Vec<f64>| changes.iter().map(|change| change * change).sum::<f64>();
        (value, (squares(self.shared_changes(&slopes)) + squares(self.own_changes(&slopes).into())).sqrt())
    }

    /// The medium as a slab.
    pub fn slab(&self, thickness_mm: f64) -> PrintLayer {
        let phase = PhaseShape::Lobes(self.second_lobe.limited_to(self.medium.g()));
        PrintLayer { medium: self.medium, phase, thickness_mm }
    }

    /// The medium moved up and down by one standard deviation along each direction in which it is uncertain.
    pub(crate) fn moved_both_ways(&self) -> Vec<[Self; 2]> {
        let of_medium = self.steps().into_iter().map(|step| [1.0, -1.0].map(|sign| self.moved(sign * step)));
        let of_lobe = self.lobe_steps().into_iter();
        let of_lobe = of_lobe.map(|(of, step)| [1.0, -1.0].map(|sign| self.with_lobe(of, sign * step)));
        of_medium.chain(of_lobe).collect()
    }

    /// The slopes of a function with this value, given its values at the ends of [`Self::moved_both_ways`].
    pub(crate) fn slopes(&self, value: f64, ends: &[f64]) -> Slopes {
        let mut changes = ends.chunks_exact(2).map(|ends| change(ends[0], ends[1], value));
        let mut slopes = Slopes { medium: Vector3::zeros(), lobe: [0.0; 2] };
        for (step, change) in self.steps().iter().zip(&mut changes) {
            slopes.medium += step * (change / step.norm_squared());
        }
        for ((of, step), change) in self.lobe_steps().iter().zip(changes) {
            slopes.lobe[*of as usize - OfLobe::Weight as usize] = change / step;
        }
        slopes
    }

    /// Changes of a function by one standard deviation of each shared source.
    pub(crate) fn shared_changes(&self, slopes: &Slopes) -> Vec<f64> {
        let by = |c: &[f64; SharedErrors::OF_MEDIUM]| {
            slopes.medium.dot(&Vector3::new(c[0], c[1], c[2])) + slopes.lobe[0] * c[3] + slopes.lobe[1] * c[4]
        };
        self.shared.iter().map(by).collect()
    }

    /// Changes of a function by one standard deviation along each direction of the medium's own errors.
    pub(crate) fn own_changes(&self, slopes: &Slopes) -> [f64; 3] {
        let shared = |i: usize, j: usize| self.shared.iter().map(|c| c[i] * c[j]).sum::<f64>();
        let own = Matrix3::from_fn(|i, j| self.covariance[i][j] - shared(i, j));
        directions(&own).map(|direction| direction.dot(&slopes.medium))
    }

    fn steps(&self) -> Vec<Vector3<f64>> {
        let all = directions(&Matrix3::from_fn(|i, j| self.covariance[i][j]));
        all.into_iter().filter(|step| step.norm() > 0.0).collect()
    }

    fn lobe_steps(&self) -> Vec<(OfLobe, f64)> {
        let step = |of: OfLobe| self.shared.iter().map(|c| c[of as usize].powi(2)).sum::<f64>().sqrt();
        [OfLobe::Weight, OfLobe::G]
            .map(|of| (of, step(of)))
            .into_iter()
            .filter(|(_, step)| *step > 0.0)
            .collect()
    }

    /// The medium moved in its coordinates; an albedo stays below 1.
    fn moved(&self, by: Vector3<f64>) -> Self {
        let m = self.medium;
        let sigma_t = (m.sigma_t_per_mm() * libm::exp(by[0])).clamp(1e-6, 1e6);
        let albedo = 1.0 - ((1.0 - m.albedo()).sqrt() + by[1]).clamp(0.0, 1.0).powi(2);
        let g = (1.0 - (1.0 - m.g()) * libm::exp(by[2])).clamp(-Print::MOST_G, Print::MOST_G);
        Self { medium: Medium::new(sigma_t, albedo, g).unwrap_or(m), ..self.clone() }
    }

    fn with_lobe(&self, of: OfLobe, by: f64) -> Self {
        let (mut weight, mut g) = (self.second_lobe.weight(), self.second_lobe.g());
        match of {
            OfLobe::Weight => weight = (weight + by).clamp(0.0, MOST_SECOND_WEIGHT),
            OfLobe::G => g = (g + by).clamp(-Print::MOST_G.min(MOST_G), Print::MOST_G.min(MOST_G)),
        }
        Self { second_lobe: SecondLobe::new(weight, g).unwrap_or(self.second_lobe), ..self.clone() }
    }
}
