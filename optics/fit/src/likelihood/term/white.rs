//! Computes the response of a profile to an error of the white reference, through the ρ of the base.

use optics_model::scene::DARKER_WHITE;

use crate::likelihood::point::Line;
use crate::surrogate::{Coordinates, Surrogate};

/// The response of the simulated profile to an error of the white reference, with which the base's ρ was measured.
#[derive(Debug, Clone)]
pub(crate) struct White {
    /// Derivative by the logarithm of the reference, on the dictionary's pixels.
    pub slope: Line,
    /// Logarithm of the question's μ, to which factors are relative.
    pub ln_mu: f64,
}

impl White {
    /// The response of a slab, from records of the same walks with both ρ; none if the scene has none.
    pub(crate) fn of(
        surrogate: &Surrogate,
        thickness_mm: f64,
        medium: Coordinates,
        ln_mu: f64,
    ) -> Option<Self> {
        let values = |of: &Surrogate| of.predict_at(thickness_mm, medium).values;
        let darker = values(&surrogate.under_darker_white()?);
        let pairs = values(surrogate).into_iter().zip(darker);
        let slope = pairs.map(|(stated, darker)| (stated - darker) / -libm::log(DARKER_WHITE)).collect();
        Some(Self { slope, ln_mu })
    }

    /// The response at the current medium.
    pub(crate) fn moved(
        &self,
        surrogate: &Surrogate,
        thickness_mm: f64,
        medium: Coordinates,
    ) -> Option<Self> {
        Self::of(surrogate, thickness_mm, medium, self.ln_mu)
    }
}
