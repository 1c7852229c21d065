//! Eliminates a profile's own unknowns from its quadratic, and computes their steps and covariance from those of the shared
//! ones.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// A profile's information on the shared unknowns.
#[derive(Debug)]
pub(crate) struct Reduced {
    /// −½ of the gradient of the cost, own unknowns following.
    pub downhill: DVector<f64>,
    /// Half of its second derivative.
    pub information: DMatrix<f64>,
    own_downhill: DVector<f64>,
    /// Own by shared.
    mixed: DMatrix<f64>,
    own: Cholesky<f64, Dyn>,
    /// Quadratic in all unknowns, the shared ones first.
    all: Quadratic,
}

/// −½ of the gradient of a cost, and half of its second derivative.
#[derive(Debug, Clone)]
pub(crate) struct Quadratic {
    pub downhill: DVector<f64>,
    pub information: DMatrix<f64>,
}

impl Reduced {
    /// `shared` are the unknowns that the profile may share.
    pub(crate) fn new(all: Quadratic, shared: usize) -> Self {
        let Quadratic { downhill, information } = &all;
        let owns = downhill.len() - shared;
        let of_shared = information.view((0, 0), (shared, shared)).clone_owned();
        let mixed = information.view((shared, 0), (owns, shared)).clone_owned();
        let of_own = information.view((shared, shared), (owns, owns)).clone_owned();
        let own = Cholesky::new(of_own).expect("a prior's 1 is on the diagonal");
        let own_downhill = downhill.rows(shared, owns).clone_owned();
        let information = of_shared - mixed.transpose() * own.solve(&mixed);
        let downhill = downhill.rows(0, shared) - mixed.transpose() * own.solve(&own_downhill);
        Self { downhill, information, own_downhill, mixed, own, all }
    }

    /// The quadratic with the profile's own unknowns damped.
    pub(crate) fn damped(&self, damping: f64) -> Self {
        let mut all = self.all.clone();
        let shared = self.downhill.len();
        (shared..all.downhill.len()).for_each(|i| all.information[(i, i)] *= 1.0 + damping);
        Self { all: self.all.clone(), ..Self::new(all, shared) }
    }

    /// The predicted fall of the cost by own unknowns alone.
    pub(crate) fn own_decrement(&self) -> f64 {
        self.own_downhill.dot(&self.own.solve(&self.own_downhill))
    }

    /// The predicted fall of the cost by a step of all unknowns.
    pub(crate) fn fall(&self, shared: &DVector<f64>, own: &DVector<f64>) -> f64 {
        let step = DVector::from_iterator(shared.len() + own.len(), shared.iter().chain(own.iter()).copied());
        2.0 * self.all.downhill.dot(&step) - step.dot(&(&self.all.information * &step))
    }

    /// The step of the profile's own unknowns that follows a step of the shared ones.
    pub(crate) fn own_step(&self, shared: &DVector<f64>) -> DVector<f64> {
        self.own.solve(&(&self.own_downhill - &self.mixed * shared))
    }

    /// The response of the own unknowns to that of the shared ones: they follow to the least cost.
    pub(crate) fn own_response(&self, shared: &DVector<f64>) -> DVector<f64> {
        -self.own.solve(&(&self.mixed * shared))
    }

    /// Covariance of the own unknowns, given that of the shared ones.
    pub(crate) fn own_covariance(&self, shared: &DMatrix<f64>) -> DMatrix<f64> {
        let along = self.own.solve(&self.mixed);
        self.own.inverse() + &along * shared * along.transpose()
    }
}
