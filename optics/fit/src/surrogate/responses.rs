//! How a profile responds to the uncertain quantities of the scene, between the media at which responses were traced.
//!
//! With u a quantity's difference from the scene's value in units of its prior's standard deviation, the profile is
//! larger by u (L + Q u). L and Q follow from one or two traced differences, Q = 0 for one. They are interpolated by
//! cubics in ln σ_t and √(1 − α), and by a parabola in ln(1 − g): responses are smooth, and a few per cent of a profile.

use optics_model::scene::Prior;

use noise::Stencil;

use super::{ALBEDO, Coordinates, G, SIGMA_T, Surrogate};

pub(crate) mod noise;

/// A response at one medium, and its derivatives by the medium's coordinates.
#[derive(Debug, Clone)]
pub(crate) struct LocalResponse {
    /// L, then its derivatives.
    linear: [Vec<f64>; 4],
    /// Q, then its derivatives; none if the response is linear.
    quadratic: Option<[Vec<f64>; 4]>,
}

/// All responses about one medium.
#[derive(Debug, Clone)]
pub(crate) struct LocalResponses {
    /// With the optical thickness for σ_t.
    at: Coordinates,
    /// By prior of the scene.
    each: Vec<LocalResponse>,
}

/// What the quantities change in a profile.
#[derive(Debug)]
pub(crate) struct ProfileChange {
    pub values: Vec<f64>,
    /// By the medium's coordinates.
    pub slopes: [Vec<f64>; 3],
    /// By each quantity.
    pub by_quantity: Vec<Vec<f64>>,
}

impl LocalResponses {
    /// Number of quantities.
    pub(crate) fn count(&self) -> usize {
        self.each.len()
    }

    /// The change of a profile of a medium and a thickness near by, with the quantities at these differences from the
    /// scene. Its derivative by the logarithm of the thickness is that by ln σ_t.
    pub(crate) fn change(&self, thickness_mm: f64, mut x: Coordinates, quantities: &[f64]) -> ProfileChange {
        let pixels = self.each.first().map_or(0, |r| r.linear[0].len());
        x[SIGMA_T] += thickness_mm.ln();
        let off: [f64; 3] = std::array::from_fn(|i| x[i] - self.at[i]);
        let zero = || vec![0.0; pixels];
        let mut change =
            ProfileChange { values: zero(), slopes: [zero(), zero(), zero()], by_quantity: Vec::new() };
        for (response, u) in self.each.iter().zip(quantities) {
            let mut by = zero();
            let mut add = |order: &[Vec<f64>; 4], factor: f64, slope: f64| {
                for p in 0..pixels {
                    let there =
                        order[0][p] + off[0] * order[1][p] + off[1] * order[2][p] + off[2] * order[3][p];
                    change.values[p] += factor * there;
                    by[p] += slope * there;
                }
                for (i, slopes) in change.slopes.iter_mut().enumerate() {
                    slopes.iter_mut().zip(&order[i + 1]).for_each(|(s, v)| *s += factor * v);
                }
            };
            add(&response.linear, *u, 1.0);
            if let Some(quadratic) = &response.quadratic {
                add(quadratic, u * u, 2.0 * u);
            }
            change.by_quantity.push(by);
        }
        change
    }
}

impl Surrogate<'_> {
    /// The responses of a slab of this thickness, about a medium; None if the dictionary has none.
    ///
    /// They are those of the nearest of the dictionary's thicknesses, at the same optical thickness.
    pub(crate) fn responses(&self, thickness_mm: f64, x: Coordinates) -> Option<LocalResponses> {
        let grid = self.grid();
        let (scene, responses) = (grid.scene(), grid.responses()?);
        let (thickness, at) = self.response_place(thickness_mm, x);
        let stencil = self.response_stencil(thickness, at);
        let each = scene.priors().iter().enumerate().map(|(index, prior)| {
            let variants =
                (0..responses.variants().len()).filter(|v| responses.variants()[*v].prior == index);
            let differences = variants.map(|v| {
                let u = responses.variants()[v].step / prior.std_error();
                (u, self.traced_difference(v, &stencil))
            });
            local_response(prior, &differences.collect::<Vec<_>>())
        });
        let each = each.collect();
        let mut optical = x;
        optical[SIGMA_T] += thickness_mm.ln();
        Some(LocalResponses { at: optical, each })
    }

    /// The nearest of the dictionary's thicknesses, and coordinates of a slab of it that is optically as thick.
    fn response_place(&self, thickness_mm: f64, mut x: Coordinates) -> (usize, Coordinates) {
        let (index, ratio) = self.nearest_thickness(thickness_mm);
        x[SIGMA_T] += ratio.ln();
        (index, x)
    }

    /// The difference that a variant makes, and its derivatives by the medium's coordinates.
    fn traced_difference(&self, variant: usize, stencil: &Stencil) -> [Vec<f64>; 4] {
        let grid = self.grid();
        let nodes = grid.responses().expect("the grid has responses");
        let records = self.dictionary.responses(self.channel);
        let Stencil { thickness, sigma_t: s, g, albedo: a } = stencil;
        let mut sums: [Vec<f64>; 4] = std::array::from_fn(|_| vec![0.0; self.pixels()]);
        for (i, (ws, ds)) in s.values.iter().zip(&s.slopes).enumerate() {
            for (k, (wg, dg)) in g.values.iter().zip(&g.slopes).enumerate() {
                for (j, (wa, da)) in a.values.iter().zip(&a.slopes).enumerate() {
                    let (sigma_t, g) = (nodes.sigma_t()[s.first + i], nodes.g()[g.first + k]);
                    let record = grid.record_at(self.ior, sigma_t, g, *thickness, a.first + j);
                    let row =
                        records.difference(variant, record).expect("responses are traced at their nodes");
                    let weights = [ws * wa * wg, -ds * wa * wg, ws * da * wg, ws * wa * dg];
                    for (sum, weight) in sums.iter_mut().zip(weights) {
                        sum.iter_mut().zip(row).for_each(|(s, v)| *s += weight * f64::from(*v));
                    }
                }
            }
        }
        sums
    }
}

/// From the differences at one or two values of u.
fn local_response(prior: &Prior, differences: &[(f64, [Vec<f64>; 4])]) -> LocalResponse {
    let combined = |f: &dyn Fn(&[f64]) -> f64| -> [Vec<f64>; 4] {
        std::array::from_fn(|i| {
            let pixels = differences[0].1[i].len();
            (0..pixels).map(|p| f(&differences.iter().map(|d| d.1[i][p]).collect::<Vec<_>>())).collect()
        })
    };
    match differences {
        [(u, _)] => LocalResponse { linear: combined(&|d| d[0] / u), quadratic: None },
        // D = u (L + Q u) at both.
        [(u, _), (v, _)] => LocalResponse {
            linear: combined(&|d| (d[0] * v / u - d[1] * u / v) / (v - u)),
            quadratic: Some(combined(&|d| (d[1] / v - d[0] / u) / (v - u))),
        },
        _ => unreachable!("a {} has one step or two", prior.kind().name()),
    }
}

#[cfg(test)]
mod tests;
