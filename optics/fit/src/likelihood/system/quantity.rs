//! Defines the functions of the unknowns whose intervals are reported.

use nalgebra::DVector;

use crate::likelihood::point::{LN_ONE_MINUS_G, LN_SIGMA_T, ROOT_CO_ALBEDO};
use crate::likelihood::term::blend::Ink;

/// A function of the unknowns whose value can be held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Quantity {
    /// One of the unknowns.
    Unknown(usize),
    /// ln σ_s(1 − g), of the medium at these unknowns.
    ReducedScattering([usize; 3]),
    /// √σ_a.
    Absorption([usize; 3]),
    /// σ_t of an ink.
    InkSigmaT(Ink),
    /// √(1 − α).
    InkRootCoAlbedo(Ink),
    /// σ_s(1 − g).
    InkReducedScattering(Ink),
}

impl Quantity {
    pub(crate) fn value(self, x: &DVector<f64>) -> f64 {
        match self {
            Self::Unknown(i) => x[i],
            Self::ReducedScattering([s, a, g]) => libm::log((1.0 - x[a] * x[a]).max(1e-12)) + x[s] + x[g],
            Self::Absorption([s, a, _]) => x[a] * libm::exp(0.5 * x[s]),
            Self::InkSigmaT([s, a, _]) => x[s] + x[a] * x[a],
            Self::InkRootCoAlbedo([s, a, _]) => x[a] / (x[s] + x[a] * x[a]).sqrt(),
            Self::InkReducedScattering([s, _, g]) => x[s] * libm::exp(x[g]),
        }
    }

    pub(crate) fn gradient(self, x: &DVector<f64>) -> DVector<f64> {
        let mut gradient = DVector::zeros(x.len());
        match self {
            Self::Unknown(i) => gradient[i] = 1.0,
            Self::ReducedScattering([s, a, g]) => {
                (gradient[s], gradient[g]) = (1.0, 1.0);
                gradient[a] = -2.0 * x[a] / (1.0 - x[a] * x[a]).max(1e-9);
            }
            Self::Absorption([s, a, _]) => {
                let root = libm::exp(0.5 * x[s]);
                (gradient[s], gradient[a]) = (0.5 * x[a] * root, root);
            }
            Self::InkSigmaT([s, a, _]) => (gradient[s], gradient[a]) = (1.0, 2.0 * x[a]),
            Self::InkRootCoAlbedo([s, a, _]) => {
                let sigma_t = x[s] + x[a] * x[a];
                let cubed = sigma_t * sigma_t.sqrt();
                (gradient[s], gradient[a]) = (-0.5 * x[a] / cubed, x[s] / cubed);
            }
            Self::InkReducedScattering([s, _, g]) => {
                let factor = libm::exp(x[g]);
                (gradient[s], gradient[g]) = (factor, x[s] * factor);
            }
        }
        gradient
    }

    /// The quantities of a channel's medium.
    pub(crate) fn all(slots: &[usize]) -> [Self; 5] {
        let medium = [slots[LN_SIGMA_T], slots[ROOT_CO_ALBEDO], slots[LN_ONE_MINUS_G]];
        [
            Self::Unknown(medium[0]),
            Self::Unknown(medium[1]),
            Self::Unknown(medium[2]),
            Self::ReducedScattering(medium),
            Self::Absorption(medium),
        ]
    }

    /// σ_t, √(1 − α), ln(1 − g), σ_s(1 − g) and √σ_a of an ink.
    pub(crate) fn of_ink(ink: Ink) -> [Self; 5] {
        [
            Self::InkSigmaT(ink),
            Self::InkRootCoAlbedo(ink),
            Self::Unknown(ink[2]),
            Self::InkReducedScattering(ink),
            Self::Unknown(ink[1]),
        ]
    }
}
