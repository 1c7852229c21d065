//! Separates the responses of a quantity from most of their noise.
//!
//! The responses of all media lie in few directions of the space of pixels, and their noise in many. Only the directions
//! in which responses are largest are kept, each with the share of its mean square that is not noise. The remaining noise
//! would make a response look stronger than it is, and so the quantity better determined.

use nalgebra::{DMatrix, SymmetricEigen};
use optics_model::Grid;

use crate::bases::{contrasts, orthonormal};
use crate::dictionary::responses::linear::LinearResponse;
use crate::dictionary::sum::{add_multiple, dot};
use crate::dictionary::wide::wide;

/// Number of directions whose share of noise is estimated.
const DIRECTIONS: usize = 16;
/// Passes over the rows that turn the directions to those of the largest mean square.
const PASSES: usize = 2;
/// Least number of independent samples of the noise: with fewer, directions would be kept whose noise is small by chance.
const LEAST_SAMPLES: usize = 6;
/// Maximum number of rows of a pass.
const MOST_ROWS: usize = 256;
/// Radiance factor that is added to means of profiles before responses are divided by them: darker profiles count less.
const DARK: f64 = 0.02;

/// The nodes of a grid's responses, in the order of their rows.
#[derive(Debug)]
pub(super) struct NodeOrder {
    ln_sigma_t: Vec<f64>,
    /// Rows between neighbours in σ_t.
    stride: usize,
    /// Number of rows with the same walks.
    albedos: usize,
}

impl NodeOrder {
    pub(super) fn of(grid: &Grid) -> Self {
        let (sigma_t, g) = grid.responses().map_or((&[][..], &[][..]), |r| (r.sigma_t(), r.g()));
        let ln_sigma_t = sigma_t.iter().map(|i| libm::log(grid.sigma_t_per_mm()[*i])).collect();
        let albedos = grid.albedo().len();
        Self { ln_sigma_t, stride: g.len() * grid.thickness_mm().len() * albedos, albedos }
    }

    /// Contrasts of rows, each of unit length, that vanish for polynomials in ln σ_t: their sums are noise.
    fn contrasts(&self, rows: usize) -> Vec<Vec<(usize, f64)>> {
        let (contrasts, block) = (contrasts(&self.ln_sigma_t), self.ln_sigma_t.len() * self.stride);
        let firsts = (0..rows).step_by(block.max(1)).flat_map(|start| start..start + self.stride);
        let at = |first: usize, contrast: &[f64]| {
            contrast.iter().enumerate().map(|(s, weight)| (first + s * self.stride, *weight)).collect()
        };
        firsts.flat_map(|first| contrasts.iter().map(move |c| at(first, c)).collect::<Vec<_>>()).collect()
    }
}

/// L of a quantity at all nodes: `[row][pixel]`.
pub(super) struct LinearRows<'a> {
    linear: &'a [f32],
    /// L divided by both scales has nearly uniform noise.
    row_scales: Vec<f64>,
    pixel_scales: Vec<f64>,
    /// Reciprocals of the pixels' scales.
    per_pixel_scale: Vec<f64>,
}

impl<'a> LinearRows<'a> {
    /// `of_scene` are the profiles in the scene.
    pub(super) fn new(linear: &'a [f32], of_scene: &[f32], pixels: usize) -> Self {
        let count = of_scene.len() / pixels;
        let mean = |values: &[f32]| DARK + values.iter().map(|v| f64::from(*v)).sum::<f64>() / pixels as f64;
        let mut pixel_scales = vec![DARK; pixels];
        for row in of_scene.chunks_exact(pixels) {
            pixel_scales.iter_mut().zip(row).for_each(|(s, v)| *s += f64::from(*v) / count as f64);
        }
        let per_pixel_scale = pixel_scales.iter().map(|scale| 1.0 / scale).collect();
        let row_scales = of_scene.chunks_exact(pixels).map(mean).collect();
        Self { linear, row_scales, pixel_scales, per_pixel_scale }
    }

    /// The part of every L that is not noise; None where nodes are too few to estimate the noise.
    pub(super) fn without_noise(&self, nodes: &NodeOrder) -> Option<LinearResponse> {
        let contrasts = nodes.contrasts(self.count());
        let directions = self.directions();
        if contrasts.len() < LEAST_SAMPLES * nodes.albedos || directions.is_empty() {
            return None;
        }
        let found: Vec<Vec<f64>> = (0..self.count()).map(|row| self.along(row, &directions)).collect();
        let (turned, squares) = principal(&found);
        let turned_by =
            |of: &[f64], k: usize| of.iter().enumerate().map(|(i, v)| v * turned[(i, k)]).sum::<f64>();
        let noise = |k: usize| {
            let sum = |contrast: &Vec<(usize, f64)>| -> f64 {
                contrast.iter().map(|(row, weight)| weight * turned_by(&found[*row], k)).sum()
            };
            contrasts.iter().map(|c| sum(c).powi(2)).sum::<f64>() / contrasts.len() as f64
        };
        let shares: Vec<f64> =
            squares.iter().enumerate().map(|(k, square)| (1.0 - noise(k) / square).max(0.0)).collect();
        let kept = DMatrix::from_diagonal(&shares.into());
        let kept = &turned * kept * turned.transpose();
        let weights = found.iter().zip(&self.row_scales).flat_map(|(found, scale)| {
            let along = |i: usize| found.iter().enumerate().map(|(j, v)| kept[(i, j)] * v).sum::<f64>();
            (0..found.len()).map(|i| (scale * along(i)) as f32).collect::<Vec<_>>()
        });
        let profile =
            |direction: &Vec<f64>| direction.iter().zip(&self.pixel_scales).map(|(d, s)| d * s).collect();
        Some(LinearResponse::Span {
            weights: weights.collect(),
            profiles: directions.iter().map(profile).collect(),
        })
    }

    fn count(&self) -> usize {
        self.row_scales.len()
    }

    fn pixels(&self, row: usize) -> std::ops::Range<usize> {
        let pixels = self.pixel_scales.len();
        row * pixels..(row + 1) * pixels
    }

    fn scaled(&self, row: usize) -> Vec<f64> {
        let scale = 1.0 / self.row_scales[row];
        let linear = self.linear[self.pixels(row)].iter().zip(&self.per_pixel_scale);
        linear.map(|(l, per_scale)| scale * f64::from(*l) * per_scale).collect()
    }

    fn along(&self, row: usize, directions: &[Vec<f64>]) -> Vec<f64> {
        let scaled = self.scaled(row);
        wide(
            #[inline(always)]
            || directions.iter().map(|d| dot(d, &scaled)).collect(),
        )
    }

    /// Orthonormal directions in which scaled responses have the largest mean square, by subspace iteration.
    fn directions(&self) -> Vec<Vec<f64>> {
        let rows = |most: usize| {
            let count = most.min(self.count());
            (0..count).map(move |k| k * self.count() / count)
        };
        let even = vec![1.0; self.pixel_scales.len()];
        let mut directions = orthonormal(rows(DIRECTIONS).map(|row| self.scaled(row)).collect(), &even);
        for _ in 0..PASSES {
            let mut next = vec![vec![0.0; even.len()]; directions.len()];
            for row in rows(MOST_ROWS) {
                let scaled = self.scaled(row);
                let along = self.along(row, &directions);
                wide(
                    #[inline(always)]
                    || {
                        for (next, along) in next.iter_mut().zip(along) {
                            add_multiple(next, along, &scaled);
                        }
                    },
                );
            }
            directions = orthonormal(next, &even);
        }
        directions
    }
}

/// Principal directions of vectors, as columns, and their mean squares.
fn principal(vectors: &[Vec<f64>]) -> (DMatrix<f64>, Vec<f64>) {
    let n = vectors[0].len();
    let product =
        |i: usize, j: usize| vectors.iter().map(|v| v[i] * v[j]).sum::<f64>() / vectors.len() as f64;
    let found = SymmetricEigen::new(DMatrix::from_fn(n, n, product));
    let squares = found.eigenvalues.iter().map(|square| square.max(f64::MIN_POSITIVE)).collect();
    (found.eigenvectors, squares)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 40;
    const NODES: [usize; 2] = [6, 30];

    /// Two directions whose sizes are polynomials in ln σ_t.
    fn exact(s: f64, k: usize, p: usize) -> f64 {
        let (x, k) = (p as f64 / PIXELS as f64, k as f64 / NODES[1] as f64);
        (1.0 + s * k) * libm::sin(3.0 * x) + (0.3 * s * s - k) * libm::cos(5.0 * x)
    }

    /// Noise falls to less than a half, and the responses are preserved.
    #[test]
    fn noise_of_responses_is_reduced() {
        let ln_sigma_t: Vec<f64> = (0..NODES[0]).map(|i| 0.6 * i as f64).collect();
        let mut seed = 1_u32;
        let mut uniform = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(seed) / f64::from(u32::MAX) - 0.5
        };
        let (mut truth, mut linear) = (Vec::new(), Vec::new());
        for s in &ln_sigma_t {
            for k in 0..NODES[1] {
                truth.extend((0..PIXELS).map(|p| exact(*s, k, p)));
            }
        }
        linear.extend(truth.iter().map(|v| (v + 0.4 * uniform()) as f32));
        let of_scene = vec![1.0; linear.len()];
        let off = |linear: &[f32]| -> f64 {
            let squares = linear.iter().zip(&truth).map(|(l, t)| (f64::from(*l) - t).powi(2));
            (squares.sum::<f64>() / truth.len() as f64).sqrt()
        };
        let before = off(&linear);
        let rows = LinearRows::new(&linear, &of_scene, PIXELS);
        let reduced = rows.without_noise(&NodeOrder { ln_sigma_t, stride: NODES[1], albedos: 5 }).unwrap();
        let each = (0..NODES[0] * NODES[1]).flat_map(|row| {
            let [values] = reduced.sums(&[(row, [1.0])]);
            values.into_iter().map(|v| v as f32).collect::<Vec<_>>()
        });
        let after = off(&each.collect::<Vec<_>>());
        assert!((0.1..0.13).contains(&before) && after < 0.4 * before, "{before} {after}");
    }

    /// With few nodes of σ_t noise cannot be estimated, and responses are unchanged.
    #[test]
    fn responses_at_one_node_are_unchanged() {
        let linear: Vec<f32> = (0..4 * PIXELS).map(|i| i as f32).collect();
        let of_scene = vec![0.5; linear.len()];
        let rows = LinearRows::new(&linear, &of_scene, PIXELS);
        assert!(rows.without_noise(&NodeOrder { ln_sigma_t: vec![1.0], stride: 4, albedos: 4 }).is_none());
    }
}
