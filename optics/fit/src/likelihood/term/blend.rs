//! Computes the medium of a mixture as a function of its inks.
//!
//! An ink's coordinates are σ_s, √σ_a and ln(1 − g). Mixtures are linear in the first, so the likelihood of dilutions is
//! nearly normal in it, down to 0; profiles of a weak absorber are linear in the second; similar media lie on straight lines
//! of the third.

use nalgebra::{DMatrix, DVector};

use crate::likelihood::point::{LN_ONE_MINUS_G, LN_SCALE, LN_SIGMA_T, Line, ROOT_CO_ALBEDO};

/// Slots of an ink's σ_s, √σ_a and ln(1 − g) among the unknowns.
pub(crate) type Ink = [usize; 3];

/// One ink of a mixture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct InkPart {
    pub fraction: f64,
    pub ink: Ink,
}

/// The mixture of inks in a profile's medium.
#[derive(Debug, Clone)]
pub(crate) struct Blend {
    pub parts: Vec<InkPart>,
    /// Limits of the media that the dictionary predicts, in its coordinates. Beyond them a profile is that at the limit.
    pub limits: [(f64, f64); 3],
}

/// Values of a profile's shared unknowns, and their derivatives by the system's unknowns in `slots`.
#[derive(Debug)]
pub(crate) struct BlendPoint {
    pub point: Line,
    pub slots: Vec<usize>,
    pub slopes: DMatrix<f64>,
}

/// A medium in the coordinates of the dictionary, and its derivatives by the inks' coordinates: three columns per ink.
#[derive(Debug)]
pub(crate) struct Blended {
    pub medium: [f64; 3],
    pub slopes: DMatrix<f64>,
}

impl Blend {
    /// The slots of the columns of [`Blended::slopes`].
    pub(crate) fn slots(&self) -> impl Iterator<Item = usize> + '_ {
        self.parts.iter().flat_map(|part| part.ink)
    }

    /// With σ_s = Σ f σ_s,i, σ_a = Σ f σ_a,i and r = Σ f σ_s,i (1 − g_i): ln σ_t, √(σ_a/σ_t), ln(r/σ_s).
    pub(crate) fn at(&self, x: &DVector<f64>) -> Blended {
        let (mut scattering, mut absorption, mut reduced) = (0.0, 0.0, 0.0);
        for InkPart { fraction, ink: [s, a, g] } in &self.parts {
            scattering += fraction * x[*s];
            absorption += fraction * x[*a] * x[*a];
            reduced += fraction * x[*s] * libm::exp(x[*g]);
        }
        let sigma_t = scattering + absorption;
        let root = (absorption / sigma_t).sqrt();
        let mut slopes = DMatrix::zeros(3, 3 * self.parts.len());
        let mut column = |k: usize, [ds, da, dr]: [f64; 3]| {
            slopes[(LN_SIGMA_T, k)] = (ds + da) / sigma_t;
            slopes[(ROOT_CO_ALBEDO, k)] =
                (scattering * da - absorption * ds) / (2.0 * root * sigma_t * sigma_t);
            slopes[(LN_ONE_MINUS_G, k)] = dr / reduced - ds / scattering;
        };
        for (k, InkPart { fraction, ink: [s, a, g] }) in self.parts.iter().enumerate() {
            let factor = libm::exp(x[*g]);
            column(3 * k, [*fraction, 0.0, fraction * factor]);
            column(3 * k + 1, [0.0, 2.0 * fraction * x[*a], 0.0]);
            column(3 * k + 2, [0.0, 0.0, fraction * x[*s] * factor]);
        }
        Blended { medium: [libm::log(sigma_t), root, libm::log(reduced / scattering)], slopes }
    }

    /// The profile's shared unknowns, with those of the set-up: from the factor on μ on.
    pub(crate) fn place(&self, slots: &[usize], x: &DVector<f64>) -> BlendPoint {
        let blended = self.at(x);
        let parts = 3 * self.parts.len();
        let set_up = LN_SCALE..slots.len();
        let used: Vec<usize> = self.slots().chain(slots[set_up.clone()].iter().copied()).collect();
        let mut slopes = DMatrix::zeros(slots.len(), used.len());
        let mut point = vec![0.0; slots.len()];
        for (i, (low, high)) in self.limits.into_iter().enumerate() {
            point[i] = blended.medium[i].clamp(low, high);
            if point[i] == blended.medium[i] {
                slopes.view_mut((i, 0), (1, parts)).copy_from(&blended.slopes.row(i));
            }
        }
        for (k, i) in set_up.enumerate() {
            point[i] = x[slots[i]];
            slopes[(i, parts + k)] = 1.0;
        }
        BlendPoint { point, slots: used, slopes }
    }

    /// This blend with other slots.
    pub(crate) fn renumbered(&self, slot: impl Fn(&usize) -> usize) -> Self {
        let part = |part: &InkPart| InkPart { ink: part.ink.each_ref().map(&slot), ..*part };
        Self { parts: self.parts.iter().map(part).collect(), limits: self.limits }
    }
}

/// An ink's own medium in the coordinates of the dictionary.
pub(crate) fn ink_medium(ink: Ink, x: &DVector<f64>) -> [f64; 3] {
    unlimited(vec![InkPart { fraction: 1.0, ink }]).at(x).medium
}

/// A mixture without limits, which the dictionary need not predict.
pub(crate) fn unlimited(parts: Vec<InkPart>) -> Blend {
    Blend { parts, limits: [(f64::NEG_INFINITY, f64::INFINITY); 3] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::likelihood::system::quantity::Quantity;

    fn unknowns() -> DVector<f64> {
        DVector::from_vec(vec![5.994, 0.0735, -0.511, 0.45, 2.924, -0.4])
    }

    /// Derivatives of a function by central differences.
    fn differences(f: impl Fn(&DVector<f64>) -> f64) -> Vec<f64> {
        let x = unknowns();
        let moved = |i: usize, by: f64| {
            let mut there = x.clone();
            there[i] += by;
            f(&there)
        };
        (0..x.len()).map(|i| (moved(i, 1e-5) - moved(i, -1e-5)) / 2e-5).collect()
    }

    #[test]
    fn mixture_adds_scattering_and_absorption() {
        let x = unknowns();
        let part = |fraction: f64, first: usize| InkPart { fraction, ink: [first, first + 1, first + 2] };
        let blend = unlimited(vec![part(0.75, 0), part(0.25, 3)]);
        let [ln_sigma_t, root, ln_one_minus_g] = blend.at(&x).medium;
        let (s, a) = (0.75 * x[0] + 0.25 * x[3], 0.75 * x[1] * x[1] + 0.25 * x[4] * x[4]);
        let g = 1.0 - (0.75 * x[0] * libm::exp(x[2]) + 0.25 * x[3] * libm::exp(x[5])) / s;
        assert!((ln_sigma_t - libm::log(s + a)).abs() < 1e-12 && (root * root * (s + a) - a).abs() < 1e-12);
        assert!((ln_one_minus_g - libm::log(1.0 - g)).abs() < 1e-12);
        let slopes = blend.at(&x).slopes;
        for row in 0..3 {
            let expected = differences(|x| blend.at(x).medium[row]);
            for (k, slot) in blend.slots().enumerate() {
                assert!((slopes[(row, k)] - expected[slot]).abs() < 1e-7, "{row} {k}");
            }
        }
    }

    #[test]
    fn gradients_of_quantities_are_their_slopes() {
        for quantity in Quantity::of_ink([0, 1, 2]).into_iter().chain(Quantity::of_ink([3, 4, 5])) {
            let expected = differences(|x| quantity.value(x));
            for (found, expected) in quantity.gradient(&unknowns()).iter().zip(expected) {
                assert!((found - expected).abs() < 1e-7 * (1.0 + expected.abs()), "{quantity:?}");
            }
        }
    }
}
