//! The reflection and transmission of a slab of a medium, by doubling (van de Hulst 1980, "Multiple light scattering").

use nalgebra::DMatrix;
use optics_model::phase::PhaseFunction;

use crate::dense::{product, solved};
use crate::operator::Operator;
use crate::quadrature::Quadrature;

/// Greatest optical thickness at which doubling begins. The trapezoidal rule over such a layer is accurate to
/// (τ/μ)³/12 of its light.
const THIN: f64 = 1.0 / 64.0;

/// A slab without its faces, in the directions of a quadrature, which passes as much from above as from below.
#[derive(Debug, Clone)]
pub(crate) struct MediumSlab {
    reflects: DMatrix<f64>,
    passes: DMatrix<f64>,
}

impl MediumSlab {
    /// A slab in a medium of index `ior`: `depth` is its optical thickness.
    pub(crate) fn new(
        quadrature: &Quadrature,
        ior: f64,
        phase: &PhaseFunction,
        albedo: f64,
        depth: f64,
    ) -> Self {
        let doublings = libm::log2(depth / THIN).ceil().max(0.0) as i32;
        let thin = thin(quadrature, ior, phase, albedo, depth / 2_f64.powi(doublings));
        (0..doublings).fold(thin, |slab, _| slab.doubled())
    }

    /// A slab of twice the thickness.
    pub(crate) fn doubled(&self) -> Self {
        let n = self.reflects.nrows();
        let between = DMatrix::identity(n, n) - product(&self.reflects, &self.reflects);
        let through = solved(between, self.passes.clone());
        let returned = product(&self.reflects, &through);
        Self {
            reflects: &self.reflects + product(&self.passes, &returned),
            passes: product(&self.passes, &through),
        }
    }

    pub(crate) fn operator(self) -> Operator {
        let Self { reflects, passes } = self;
        Operator {
            reflects_above: reflects.clone(),
            reflects_below: reflects,
            down: passes.clone(),
            up: passes,
        }
    }
}

/// Reflection and transmission of a thin slab by the trapezoidal rule.
///
/// With D downwards and U upwards, dD/dτ = A D + B U and −dU/dτ = A U + B D. For light that arrives from both sides, alike
/// or with opposite signs, both are the solutions E± = (1 − τ/2 (A ± B))⁻¹ (1 + τ/2 (A ± B)) = T ± R.
fn thin(quadrature: &Quadrature, ior: f64, phase: &PhaseFunction, albedo: f64, tau: f64) -> MediumSlab {
    let n = quadrature.len();
    let (forward, backward) = scattering(quadrature, ior, phase);
    let exists = |i: usize| quadrature.exists(i, ior);
    let half = |i: usize| 0.5 * tau / quadrature.cosine(i, ior).max(1e-9);
    let side = |sign: f64| {
        // Directions that do not exist in the slab pass nothing.
        let step = DMatrix::from_fn(n, n, |i, j| {
            if !exists(i) || !exists(j) {
                return 0.0;
            }
            let scattered = albedo * (forward[(i, j)] + sign * backward[(i, j)]);
            half(i) * (scattered - if i == j { 1.0 } else { 0.0 })
        });
        let one = DMatrix::from_fn(n, n, |i, j| if i == j { 1.0 } else { 0.0 });
        let kept = DMatrix::from_fn(n, n, |i, j| if i == j && exists(i) { 1.0 } else { 0.0 });
        solved(one - &step, kept + step)
    };
    let (even, odd) = (side(1.0), side(-1.0));
    MediumSlab { reflects: (&even - &odd) * 0.5, passes: (even + odd) * 0.5 }
}

/// Shares of the light scattered in direction i that come from direction j, on the same way down or up, and on the other:
/// ½ p̄(μᵢ, ±μⱼ) dμⱼ, with p̄ the mean over the azimuth. The diagonal of the narrower peak is corrected so that no light is
/// lost (Hansen 1971, "Multiple scattering of polarized light in planetary atmospheres").
fn scattering(quadrature: &Quadrature, ior: f64, phase: &PhaseFunction) -> (DMatrix<f64>, DMatrix<f64>) {
    let n = quadrature.len();
    let share = |i: usize, j: usize, sign: f64| {
        if quadrature.weights[j] == 0.0 || !quadrature.exists(i, ior) || !quadrature.exists(j, ior) {
            return 0.0;
        }
        let [u, mu] = [i, j].map(|k| quadrature.cosine(k, ior));
        2.0 * std::f64::consts::PI * phase.azimuthal_mean(sign * u, mu) * quadrature.cosine_weight(j, ior)
    };
    let mut forward = DMatrix::from_fn(n, n, |i, j| share(i, j, 1.0));
    let mut backward = DMatrix::from_fn(n, n, |i, j| share(i, j, -1.0));
    for i in (0..n).filter(|i| quadrature.exists(*i, ior)) {
        let sum = forward.row(i).sum() + backward.row(i).sum();
        if i == quadrature.sensor() {
            forward.row_mut(i).iter_mut().chain(backward.row_mut(i).iter_mut()).for_each(|v| *v /= sum);
        } else if phase.mean_cosine() < 0.0 {
            backward[(i, i)] += 1.0 - sum;
        } else {
            forward[(i, i)] += 1.0 - sum;
        }
    }
    (forward, backward)
}
