//! Estimates the noise of the responses in a prediction from the scatter of traced responses about polynomials in ln σ_t.
//!
//! At every node of ln(1 − g) the response of a quantity is modelled by a polynomial in ln σ_t. The contrasts of the
//! nodes that vanish for such polynomials, each of unit length, have the noise of one response. Where the polynomial does
//! not fit the response they are larger: the noise is then overestimated.

use super::{ALBEDO, Coordinates, G, SIGMA_T, Surrogate};
use crate::bases::contrasts;
use crate::dictionary::responses::{ResponseCurve, ResponseRecords};
use crate::surrogate::interpolation;
use crate::surrogate::local_axis::{Direction, Weights};
use crate::surrogate::noise::NoisePlace;

/// The noise of the responses in a prediction.
#[derive(Debug)]
pub(crate) struct ResponseNoise {
    /// By prior of the scene: its curve, and profiles f_k such that Σ f_k f_kᵀ is the covariance of L.
    each: Vec<(ResponseCurve, Vec<Vec<f64>>)>,
    /// The walks that the responses come from.
    pub place: NoisePlace,
}

impl ResponseNoise {
    /// Profiles f_k such that Σ f_k f_kᵀ is the covariance that the noise of a quantity's response gives to a prediction,
    /// with the quantity at u ± 1 standard deviation of its prior. A fit's own standard error of u is not used, since the
    /// noise itself makes it too small.
    pub(crate) fn factors(&self, prior: usize, u: f64) -> Vec<Vec<f64>> {
        let (curve, factors) = &self.each[prior];
        let (height, slope) = curve.at(u);
        let size = height.hypot(slope);
        factors.iter().map(|f| f.iter().map(|v| size * v).collect()).collect()
    }
}

/// Weights of the nodes between which responses are interpolated.
pub(super) struct Stencil {
    /// Index of the dictionary's thickness.
    pub thickness: usize,
    pub sigma_t: Weights,
    pub g: Weights,
    pub albedo: Weights,
}

impl Surrogate<'_> {
    /// The noise of the responses near a medium; None if the dictionary has none.
    pub(crate) fn response_noise(&self, thickness_mm: f64, x: Coordinates) -> Option<ResponseNoise> {
        let grid = self.grid();
        let responses = grid.responses()?;
        let records = self.dictionary.responses(self.channel)?;
        let (thickness, at) = self.response_place(thickness_mm, x);
        let stencil = self.response_stencil(thickness, at);
        let of_prior = |prior: usize| (records.curve(prior), self.scatter(records, prior, &stencil));
        let each = (0..grid.scene().priors().len()).map(of_prior).collect();
        let depth = |i: &usize| (grid.sigma_t_per_mm()[*i] * grid.thickness_mm()[thickness]) as f32;
        let depths = responses.sigma_t().iter().map(depth).collect();
        let directions = [Direction::of(&stencil.sigma_t), Direction::of(&stencil.g)];
        Some(ResponseNoise { each, place: self.noise_place(at[ALBEDO], depths, directions) })
    }

    /// Profiles f_k whose Σ f_k f_kᵀ is the covariance of an interpolated L.
    fn scatter(&self, records: &ResponseRecords, prior: usize, stencil: &Stencil) -> Vec<Vec<f64>> {
        let grid = self.grid();
        let nodes = grid.responses().expect("the grid has responses");
        let x: Vec<f64> = nodes.sigma_t().iter().map(|i| grid.sigma_t_per_mm()[*i].ln()).collect();
        let contrasts = contrasts(&x);
        let count = contrasts.len() * nodes.g().len();
        let square = |w: &Weights| w.values.iter().map(|w| w * w).sum::<f64>();
        let size = (square(&stencil.sigma_t) * square(&stencil.g) / count.max(1) as f64).sqrt();
        let mut factors = Vec::with_capacity(count);
        for g in nodes.g() {
            for contrast in &contrasts {
                let mut factor = vec![0.0; self.pixels()];
                for (sigma_t, of_node) in nodes.sigma_t().iter().zip(contrast) {
                    for (j, of_albedo) in stencil.albedo.values.iter().enumerate() {
                        let albedo = stencil.albedo.first + j;
                        let record = grid.record_at(self.ior, *sigma_t, *g, stencil.thickness, albedo);
                        let row = records.linear(prior, record).expect("responses are traced at their nodes");
                        let weight = size * of_node * of_albedo;
                        factor.iter_mut().zip(row).for_each(|(v, d)| *v += weight * f64::from(*d));
                    }
                }
                factors.push(factor);
            }
        }
        factors
    }

    /// The weights of the nodes at coordinates.
    pub(super) fn response_stencil(&self, thickness: usize, x: Coordinates) -> Stencil {
        let grid = self.grid();
        let nodes = grid.responses().expect("the grid has responses");
        // Interpolation requires nodes in descending order.
        let s_nodes: Vec<f64> = nodes.sigma_t().iter().map(|i| -grid.sigma_t_per_mm()[*i].ln()).collect();
        let g_nodes: Vec<f64> = nodes.g().iter().map(|i| (1.0 - grid.g()[*i]).ln()).collect();
        let clamped = |nodes: &[f64], x: f64| x.clamp(nodes[nodes.len() - 1], nodes[0]);
        Stencil {
            thickness,
            sigma_t: interpolation(&s_nodes, clamped(&s_nodes, -x[SIGMA_T])),
            g: interpolation(&g_nodes, clamped(&g_nodes, x[G])),
            albedo: interpolation(&self.albedo, x[ALBEDO]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The noise of a response counts by the height of its curve, and by its slope.
    #[test]
    fn noise_follows_height_and_slope() {
        let each = vec![
            (ResponseCurve::default(), vec![vec![2.0]]),
            (ResponseCurve { bend: 0.25, curvature: 0.1 }, vec![vec![5.0], vec![1.0]]),
        ];
        let noise = ResponseNoise { each, place: NoisePlace::default() };
        assert_eq!(noise.factors(0, 0.0), [[2.0]]);
        // w = 3 with the slope 2.
        let size = 3.9_f64.hypot(1.6 * 2.0);
        let found = noise.factors(1, 2.0);
        assert!((found[0][0] - 5.0 * size).abs() < 1e-12 && (found[1][0] - size).abs() < 1e-12, "{found:?}");
    }
}
