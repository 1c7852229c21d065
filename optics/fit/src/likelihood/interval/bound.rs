//! Computes the Cramér–Rao bound: the least covariance of an unbiased estimate from these pixels.

use nalgebra::DMatrix;
use optics_model::fit::{Bound, Ends, Z};

use crate::likelihood::point::Line;
use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::{State, System};
use crate::surrogate::{albedo, g, sigma_t};

/// Least covariance of all unknowns that the pixels and the priors allow. None if the information is singular.
pub(crate) fn ideal_covariance(system: &System, state: &State) -> Option<DMatrix<f64>> {
    let ideal = system.ideal();
    let own: Vec<Line> =
        ideal.terms.iter().zip(&state.own).map(|(term, own)| own[..term.own_count()].to_vec()).collect();
    let linear = ideal.linear(&state.x, &own);
    ideal.covariance(&ideal.normal(&state.x, &own, &linear).information)
}

/// The bound of a channel's medium, given the least covariance of all unknowns.
pub(crate) fn bound(covariance: &DMatrix<f64>, state: &State, slots: &[usize]) -> Bound {
    let [s, a, g_, reduced, absorption] = Quantity::all(slots).map(|quantity| {
        let gradient = quantity.gradient(&state.x);
        let half = Z * gradient.dot(&(covariance * &gradient)).max(0.0).sqrt();
        let value = quantity.value(&state.x);
        (value - half, value + half)
    });
    let root = |v: f64| v.clamp(0.0, 1.0);
    let squared = |v: f64| v.max(0.0).powi(2);
    Bound {
        sigma_t_per_mm: Ends { low: sigma_t(s.0), high: sigma_t(s.1) },
        albedo: Ends { low: albedo(root(a.1)), high: albedo(root(a.0)) },
        g: Ends { low: g(g_.1), high: g(g_.0) },
        reduced_scattering_per_mm: Ends { low: libm::exp(reduced.0), high: libm::exp(reduced.1) },
        absorption_per_mm: Ends { low: squared(absorption.0), high: squared(absorption.1) },
    }
}
