//! Estimates the noise of the responses in a prediction from the scatter of traced responses about polynomials in ln σ_t.
//!
//! At every node of ln(1 − g) the response of a quantity is modelled by a polynomial in ln σ_t. The contrasts of the
//! nodes that vanish for such polynomials, each of unit length, have the noise of one response. Where the polynomial does
//! not fit the response they are larger: the noise is then overestimated.

use std::borrow::Cow;

use optics_model::scene::Prior;

use super::{ALBEDO, Coordinates, G, SIGMA_T, Surrogate};
use crate::bases::contrasts;
use crate::dictionary::responses::linear::LinearResponse;
use crate::dictionary::responses::{ResponseCurve, ResponseRecords};
use crate::surrogate::interpolation;
use crate::surrogate::local_axis::{Direction, Weights};
use crate::surrogate::noise::NoisePlace;

/// The noise of the responses in a prediction.
#[derive(Debug)]
pub(crate) struct ResponseNoise {
    /// By prior of the scene.
    each: Vec<PriorNoise>,
    /// The walks that the responses come from.
    pub place: NoisePlace,
}

/// The noise of the response to one quantity.
#[derive(Debug)]
struct PriorNoise {
    /// The channel's difference from the scene's value, in standard deviations.
    in_channel: f64,
    /// h, and profiles f_k such that Σ f_k f_kᵀ is the covariance of L.
    parts: Vec<(ResponseCurve, Vec<Vec<f64>>)>,
}

impl ResponseNoise {
    /// Profiles f_k such that Σ f_k f_kᵀ is the covariance that the noise of a quantity's response gives to a
    /// prediction, with the quantity at u ± 1 standard deviation of its prior, or less where the data determine it
    /// better. A fit's own standard error of u is not used, since the noise itself makes it too small.
    pub(crate) fn factors(&self, prior: usize, u: f64) -> Vec<Vec<f64>> {
        let PriorNoise { in_channel, parts } = &self.each[prior];
        let part_factors = |(curve, factors): &(ResponseCurve, Vec<Vec<f64>>)| {
            let (height, slope) = curve.at(in_channel + u);
            let size = libm::hypot(height, curve.reach(in_channel + u) * slope);
            factors.iter().map(|f| f.iter().map(|v| size * v).collect()).collect::<Vec<_>>()
        };
        parts.iter().flat_map(part_factors).collect()
    }
}

/// 1 − α of media halfway between bright and dark: the effect of a second lobe is that of many scatterings and of one.
const CO_ALBEDO: f64 = 0.08;

/// Weights of the nodes between which responses are interpolated.
pub(super) struct Stencil {
    /// Index of the dictionary's thickness.
    pub thickness: usize,
    pub sigma_t: Weights,
    g: Weights,
    /// For quantities of the phase function in bright media.
    g_of_bright: Weights,
    pub albedo: Weights,
}

impl Stencil {
    /// Weights of the nodes of g for a quantity, in a medium with this √(1 − α).
    pub(super) fn along_g(&self, prior: &Prior, root_co_albedo: f64) -> Cow<'_, Weights> {
        if !prior.kind().is_of_phase() {
            return Cow::Borrowed(&self.g);
        }
        let co_albedo = root_co_albedo * root_co_albedo;
        let dark = co_albedo / (co_albedo + CO_ALBEDO);
        let mixed = |bright: &[f64], plain: &[f64]| {
            bright.iter().zip(plain).map(|(b, p)| (1.0 - dark) * b + dark * p).collect()
        };
        let (bright, plain) = (&self.g_of_bright, &self.g);
        Cow::Owned(Weights {
            first: plain.first,
            values: mixed(&bright.values, &plain.values),
            slopes: mixed(&bright.slopes, &plain.slopes),
        })
    }
}

impl Surrogate<'_> {
    /// The noise of the responses near a medium; None if the dictionary has none.
    pub(crate) fn response_noise(&self, thickness_mm: f64, x: Coordinates) -> Option<ResponseNoise> {
        let grid = self.grid();
        let responses = grid.responses()?;
        let records = self.dictionary.responses(self.channel)?;
        let (thickness, at) = self.response_place(thickness_mm, x);
        let stencil = self.response_stencil(thickness, at);
        let prior_noise = |prior: usize| PriorNoise {
            in_channel: self.in_channel(prior),
            parts: self.scatter(records, prior, &stencil, at[ALBEDO]),
        };
        let each = (0..grid.scene().priors().len()).map(prior_noise).collect();
        let depth = |i: &usize| (grid.sigma_t_per_mm()[*i] * grid.thickness_mm()[thickness]) as f32;
        let depths = responses.sigma_t().iter().map(depth).collect();
        let directions = [Direction::of(&stencil.sigma_t), Direction::of(&stencil.g)];
        Some(ResponseNoise { each, place: self.noise_place(at[ALBEDO], depths, directions) })
    }

    /// The curves of a quantity, each with profiles f_k whose Σ f_k f_kᵀ is the covariance of an interpolated L.
    fn scatter(
        &self,
        records: &ResponseRecords,
        prior: usize,
        stencil: &Stencil,
        root_co_albedo: f64,
    ) -> Vec<(ResponseCurve, Vec<Vec<f64>>)> {
        let grid = self.grid();
        let nodes = grid.responses().expect("the grid has responses");
        let x: Vec<f64> = nodes.sigma_t().iter().map(|i| libm::log(grid.sigma_t_per_mm()[*i])).collect();
        let contrasts = contrasts(&x);
        let count = contrasts.len() * nodes.g().len();
        let square = |w: &Weights| w.values.iter().map(|w| w * w).sum::<f64>();
        let of_g = square(&stencil.along_g(&grid.scene().priors()[prior], root_co_albedo));
        let size = (square(&stencil.sigma_t) * of_g / count.max(1) as f64).sqrt();
        let mut sums = Vec::with_capacity(count);
        for g in nodes.g() {
            for contrast in &contrasts {
                let mut rows = Vec::new();
                for (sigma_t, of_node) in nodes.sigma_t().iter().zip(contrast) {
                    for (j, of_albedo) in stencil.albedo.values.iter().enumerate() {
                        let albedo = stencil.albedo.first + j;
                        let record = grid.record_at(self.ior, *sigma_t, *g, stencil.thickness, albedo);
                        let row = records.row(record).expect("responses are traced at their nodes");
                        rows.push((row, [size * of_node * of_albedo]));
                    }
                }
                sums.push(rows);
            }
        }
        let scaled_part = |(curve, linear): &(ResponseCurve, LinearResponse)| {
            let factors = sums.iter().flat_map(|rows| linear.sums(rows)).collect();
            (curve.clone(), factors)
        };
        records.parts(prior).iter().map(scaled_part).collect()
    }

    /// The weights of the nodes at coordinates.
    pub(super) fn response_stencil(&self, thickness: usize, x: Coordinates) -> Stencil {
        let grid = self.grid();
        let nodes = grid.responses().expect("the grid has responses");
        // Interpolation requires nodes in descending order.
        let s_nodes: Vec<f64> =
            nodes.sigma_t().iter().map(|i| -libm::log(grid.sigma_t_per_mm()[*i])).collect();
        let g_nodes: Vec<f64> = nodes.g().iter().map(|i| libm::log(1.0 - grid.g()[*i])).collect();
        let clamped = |nodes: &[f64], x: f64| x.clamp(nodes[nodes.len() - 1], nodes[0]);
        Stencil {
            thickness,
            sigma_t: interpolation(&s_nodes, clamped(&s_nodes, -x[SIGMA_T])),
            g: interpolation(&g_nodes, clamped(&g_nodes, x[G])),
            g_of_bright: along_growth(&g_nodes, clamped(&g_nodes, x[G])),
            albedo: interpolation(&self.albedo, x[ALBEDO]),
        }
    }
}

/// Weights, with derivatives by y = ln(1 − g), of a parabola in (1 − g)^{−3/2} through the nodes of y.
fn along_growth(nodes: &[f64], y: f64) -> Weights {
    // Falling nodes, as interpolation requires.
    let growth = |y: f64| -libm::exp(-1.5 * y);
    let nodes: Vec<f64> = nodes.iter().map(|y| growth(*y)).collect();
    let mut weights = interpolation(&nodes, growth(y));
    weights.slopes.iter_mut().for_each(|slope| *slope *= -1.5 * growth(y));
    weights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dictionary::responses::BentCurve;

    /// Functions 1 and (1 − g)⁻³ of the nodes are reproduced, with their derivatives by ln(1 − g).
    #[test]
    fn growth_with_g_is_exact() {
        let nodes = [0.0, 0.55, 0.8].map(|g: f64| libm::log(1.0 - g));
        for g in [0.1, 0.4, 0.7_f64] {
            let y = libm::log(1.0 - g);
            let weights = along_growth(&nodes, y);
            let sum = |weights: &[f64], power: f64| -> f64 {
                weights.iter().zip(&nodes[weights.len() - 3..]).map(|(w, y)| w * libm::exp(power * y)).sum()
            };
            assert!(
                (sum(&weights.values, 0.0) - 1.0).abs() < 1e-12 && sum(&weights.slopes, 0.0).abs() < 1e-9
            );
            let exact = libm::exp(-3.0 * y);
            assert!((sum(&weights.values, -3.0) / exact - 1.0).abs() < 1e-12);
            assert!((sum(&weights.slopes, -3.0) / exact + 3.0).abs() < 1e-9);
        }
    }

    /// The noise of a response counts by the height of its curve, and by its slope.
    #[test]
    fn noise_follows_height_and_slope() {
        let prior_noise = |curve, in_channel, factors| {
            let parts = vec![(ResponseCurve::Bent(curve), factors)];
            PriorNoise { in_channel, parts }
        };
        let bent = BentCurve { bend: 0.25, curvature: 0.1 };
        let each = vec![
            prior_noise(BentCurve::default(), 0.0, vec![vec![2.0]]),
            prior_noise(bent, 0.5, vec![vec![5.0], vec![1.0]]),
        ];
        let noise = ResponseNoise { each, place: NoisePlace::default() };
        assert_eq!(noise.factors(0, 0.0), [[2.0]]);
        // w = 3 with the slope 2.
        let size = libm::hypot(3.9_f64, 1.6 * 2.0);
        let found = noise.factors(1, 1.5);
        assert!((found[0][0] - 5.0 * size).abs() < 1e-12 && (found[1][0] - size).abs() < 1e-12, "{found:?}");
    }
}
