//! Predicts profiles between the records by a smooth model of the dictionary that also averages its noise.
//!
//! The coordinates are those in which profiles change most nearly linearly: ln σ_t; √(1 − α), in which diffusion is
//! linear; and ln(1 − g), in which similar media lie on straight lines. Across σ_t and g, where every record of a
//! thickness has its own walks, a local model is fitted by weighted least squares, which averages the noise of the
//! neighbouring records; across albedos, which share their walks, the four nearest are interpolated.

pub(crate) mod interpolation;
mod local_axis;
mod noise;
pub(crate) mod place;
pub(crate) mod resample;
pub(crate) mod responses;
pub(crate) mod thickness;

use std::borrow::Cow;

use optics_model::fit::{Bounds, FitOptions};
use optics_model::{Grid, Medium};

use crate::dictionary::FitDictionary;
use crate::dictionary::wide::wide;
use local_axis::{LocalAxis, Weights};

pub(crate) use noise::{NoiseFactors, NoisePlace};
pub use thickness::predicts_thickness;

/// Position in (ln σ_t, √(1 − α), ln(1 − g)).
pub(crate) type Coordinates = [f64; 3];
pub(crate) const SIGMA_T: usize = 0;
pub(crate) const ALBEDO: usize = 1;
pub(crate) const G: usize = 2;

pub(crate) fn coordinates(medium: &Medium) -> Coordinates {
    [libm::log(medium.sigma_t_per_mm()), (1.0 - medium.albedo()).sqrt(), libm::log(1.0 - medium.g())]
}

pub(crate) fn sigma_t(ln_sigma_t: f64) -> f64 {
    libm::exp(ln_sigma_t)
}

pub(crate) fn albedo(root_co_albedo: f64) -> f64 {
    1.0 - root_co_albedo * root_co_albedo
}

pub(crate) fn g(ln_one_minus_g: f64) -> f64 {
    1.0 - libm::exp(ln_one_minus_g)
}

/// Cubic interpolation between the four nearest nodes, or all if there are fewer. `nodes` are in descending order.
fn interpolation(nodes: &[f64], x: f64) -> Weights {
    let n = nodes.len();
    let count = n.min(4);
    let after = nodes.partition_point(|v| *v >= x);
    let first = after.saturating_sub(2).min(n - count);
    let near = &nodes[first..first + count];
    let weight = |i: usize| -> (f64, f64) {
        let others = || (0..count).filter(move |j| *j != i);
        let value = others().map(|j| (x - near[j]) / (near[i] - near[j])).product();
        let slope = others().map(|k| {
            let rest: f64 =
                others().filter(|j| *j != k).map(|j| (x - near[j]) / (near[i] - near[j])).product();
            rest / (near[i] - near[k])
        });
        (value, slope.sum())
    };
    let (values, slopes) = (0..count).map(weight).unzip();
    Weights { first, values, slopes }
}

/// A profile between the records and its derivatives by the coordinates.
#[derive(Debug, Clone)]
pub(crate) struct Prediction {
    pub values: Vec<f64>,
    pub slopes: [Vec<f64>; 3],
}

/// The model of one channel at one refractive index of the sample.
#[derive(Debug)]
pub(crate) struct Surrogate<'a> {
    dictionary: &'a FitDictionary,
    channel: usize,
    ior: usize,
    sigma_t: LocalAxis,
    g: LocalAxis,
    /// √(1 − α), in descending order.
    albedo: Vec<f64>,
}

impl<'a> Surrogate<'a> {
    pub(crate) fn new(dictionary: &'a FitDictionary, channel: usize, ior: usize) -> Self {
        let grid = dictionary.grid();
        let sigma_t = grid.sigma_t_per_mm().iter().map(|v| libm::log(*v)).collect();
        let g = grid.g().iter().map(|v| libm::log(1.0 - v)).collect();
        let albedo = grid.albedo().iter().map(|v| (1.0 - v).sqrt()).collect();
        Self {
            dictionary,
            channel,
            ior,
            sigma_t: LocalAxis::new(sigma_t, 0.75),
            g: LocalAxis::along_g(g, 1.0, grid.scene().phase()),
            albedo,
        }
    }

    /// A surrogate over a board whose ρ were measured with a darker white reference, if the scene has them.
    pub(crate) fn under_darker_white(&self) -> Option<Self> {
        let channel = self.grid().scene().under_darker_white(self.channel)?;
        Some(Self::new(self.dictionary, channel, self.ior))
    }

    pub(crate) fn grid(&self) -> &'a Grid {
        self.dictionary.grid()
    }

    /// Least and greatest value of each coordinate.
    pub(crate) fn limits(&self) -> [(f64, f64); 3] {
        let albedo = (self.albedo[self.albedo.len() - 1], self.albedo[0]);
        [self.sigma_t.range(), albedo, self.g.range()]
    }

    /// Least and greatest coordinates within both the dictionary and the bounds.
    pub(crate) fn limits_within(&self, options: &FitOptions) -> [(f64, f64); 3] {
        let settings = options.settings();
        let within = |(low, high): (f64, f64), bounds: Bounds, forward: fn(f64) -> f64| {
            let (a, b) = (forward(bounds.min()), forward(bounds.max()));
            let (a, b) = if a.is_nan() || b.is_nan() { (low, high) } else { (a.min(b), a.max(b)) };
            (a.clamp(low, high), b.clamp(low, high))
        };
        let [sigma_t, albedo, g] = self.limits();
        [
            within(
                sigma_t,
                settings.sigma_t_per_mm,
                |v| if v > 0.0 { libm::log(v) } else { f64::NEG_INFINITY },
            ),
            within(albedo, settings.albedo, |v| if v < 1.0 { (1.0 - v).sqrt() } else { 0.0 }),
            within(g, settings.g, |v| if v < 1.0 { libm::log(1.0 - v) } else { f64::NEG_INFINITY }),
        ]
    }

    /// Number of a record, by its place on the axes.
    fn record(&self, [sigma_t, g, thickness, albedo]: [usize; 4]) -> usize {
        self.dictionary.grid().record_at(self.ior, sigma_t, g, thickness, albedo)
    }

    /// The values of a record.
    fn row(&self, place: [usize; 4], pixels: std::ops::Range<usize>) -> Cow<'a, [f32]> {
        self.dictionary.records(self.channel).values(self.record(place), pixels)
    }

    /// The profile at one of the dictionary's thicknesses.
    pub(crate) fn predict(&self, thickness: usize, x: Coordinates) -> Prediction {
        let Neighbours { sigma_t: s, albedo: a, g } = self.neighbours(x);
        let records = self.dictionary.records(self.channel);
        let coefficients = self.dictionary.coefficients(self.channel);
        let count = coefficients.count();
        // At most four weights; the others are 0.
        let weights_of = |weights: &[f64]| std::array::from_fn(|j| weights.get(j).copied().unwrap_or(0.0));
        let albedos = AlbedoWeights { values: weights_of(&a.values), slopes: weights_of(&a.slopes) };
        let mut sums = NodeSums::new(count);
        let mut whole =
            Prediction { values: vec![0.0; count], slopes: std::array::from_fn(|_| vec![0.0; count]) };
        for i in 0..s.values.len() {
            let node = |k: usize| {
                let first = self.record([s.first + i, g.first + k, thickness, a.first]);
                let row = |j: usize| coefficients.row(records, first + j.min(a.values.len() - 1));
                Node { rows: std::array::from_fn(row), weight: g.values[k], slope: g.slopes[k] }
            };
            let nodes: Vec<Node> = (0..g.values.len()).map(node).collect();
            let (weight, slope) = (s.values[i], s.slopes[i]);
            wide(
                #[inline(always)]
                || {
                    sums.sum(&nodes, &albedos);
                    add_scaled(&mut whole.values, weight, &sums.value);
                    add_scaled(&mut whole.slopes[SIGMA_T], slope, &sums.value);
                    add_scaled(&mut whole.slopes[ALBEDO], weight, &sums.by_albedo);
                    add_scaled(&mut whole.slopes[G], weight, &sums.by_g);
                },
            );
        }
        let [by_s, by_a, by_g] = &whole.slopes;
        let [values, slopes @ ..] = coefficients.profiles([&whole.values, by_s, by_a, by_g]);
        Prediction { values, slopes }
    }

    /// The media near a place, over whose records a prediction is a sum.
    pub(crate) fn neighbours(&self, x: Coordinates) -> Neighbours {
        self.dictionary.stop.check();
        let (sigma_t, g) = (self.sigma_t.weights(x[SIGMA_T]), self.g.weights(x[G]));
        Neighbours { sigma_t, albedo: interpolation(&self.albedo, x[ALBEDO]), g }
    }

    /// The neighbours at another extinction.
    pub(crate) fn at_sigma_t(&self, near: &Neighbours, ln_sigma_t: f64) -> Neighbours {
        Neighbours { sigma_t: self.sigma_t.weights(ln_sigma_t), ..near.clone() }
    }

    /// The sum of a number over media near by, which is given by their numbers over all axes; then its derivatives by the
    /// coordinates.
    pub(crate) fn sums(&self, near: &Neighbours, of_media: &[f32]) -> [f64; 4] {
        let grid = self.dictionary.grid();
        let (count, albedos) = (grid.g().len(), grid.albedo().len());
        let Neighbours { sigma_t: s, albedo: a, g } = near;
        let mut sums = [0.0; 4];
        for (i, (weight, slope)) in s.values.iter().zip(&s.slopes).enumerate() {
            let row = self.ior * grid.sigma_t_per_mm().len() + s.first + i;
            let (mut value, mut by_albedo, mut by_g) = (0.0, 0.0, 0.0);
            for (k, (of_g, slope_g)) in g.values.iter().zip(&g.slopes).enumerate() {
                let first = (row * count + g.first + k) * albedos + a.first;
                let media = &of_media[first..first + a.values.len()];
                let along =
                    |weights: &[f64]| media.iter().zip(weights).map(|(c, w)| f64::from(*c) * w).sum::<f64>();
                let mixed = along(&a.values);
                value += of_g * mixed;
                by_albedo += of_g * along(&a.slopes);
                by_g += slope_g * mixed;
            }
            sums[0] += weight * value;
            sums[1] += slope * value;
            sums[2] += weight * by_albedo;
            sums[3] += weight * by_g;
        }
        sums
    }
}

/// Weights of the nodes near a place, along each axis.
#[derive(Debug, Clone)]
pub(crate) struct Neighbours {
    sigma_t: Weights,
    albedo: Weights,
    g: Weights,
}

/// Weights of four albedos, and their derivatives.
struct AlbedoWeights {
    values: [f64; 4],
    slopes: [f64; 4],
}

/// Records of one σ_t and g at four albedos, the weight of this g and its derivative.
struct Node<'a> {
    rows: [&'a [f32]; 4],
    weight: f64,
    slope: f64,
}

/// Number of coefficients that are summed at a time: as many as vector registers hold.
const BLOCK: usize = 8;

/// Sums over the records of one σ_t: the coefficients, and their derivatives by √(1 − α) and ln(1 − g).
struct NodeSums {
    value: Vec<f64>,
    by_albedo: Vec<f64>,
    by_g: Vec<f64>,
}

impl NodeSums {
    fn new(count: usize) -> Self {
        let zero = || vec![0.0; count];
        Self { value: zero(), by_albedo: zero(), by_g: zero() }
    }

    #[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
    #[inline(always)]
    fn sum(&mut self, nodes: &[Node], albedos: &AlbedoWeights) {
        let count = self.value.len();
        let whole = count / BLOCK * BLOCK;
        for at in (0..whole).step_by(BLOCK) {
            self.sum_block::<BLOCK>(nodes, albedos, at);
        }
        for at in whole..count {
            self.sum_block::<1>(nodes, albedos, at);
        }
    }

    #[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
    #[inline(always)]
    fn sum_block<const N: usize>(&mut self, nodes: &[Node], albedos: &AlbedoWeights, at: usize) {
        let mix = |v: [f64; 4], w: &[f64; 4]| v[0] * w[0] + v[1] * w[1] + v[2] * w[2] + v[3] * w[3];
        let [mut value, mut by_albedo, mut by_g] = [[0.0; N]; 3];
        for node in nodes {
            // One by one: calls of closures by `map` are not all vectorised.
            let [a, b, c, d] = node.rows;
            let rows: [&[f32; N]; 4] = [block(a, at), block(b, at), block(c, at), block(d, at)];
            for p in 0..N {
                let v = [rows[0][p].into(), rows[1][p].into(), rows[2][p].into(), rows[3][p].into()];
                let mixed = mix(v, &albedos.values);
                value[p] += node.weight * mixed;
                by_albedo[p] += node.weight * mix(v, &albedos.slopes);
                by_g[p] += node.slope * mixed;
            }
        }
        self.value[at..at + N].copy_from_slice(&value);
        self.by_albedo[at..at + N].copy_from_slice(&by_albedo);
        self.by_g[at..at + N].copy_from_slice(&by_g);
    }
}

#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn block<const N: usize>(row: &[f32], at: usize) -> &[f32; N] {
    row[at..].first_chunk().expect("the block is whole")
}

/// Adds factor · v.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
pub(crate) fn add_scaled(sum: &mut [f64], factor: f64, v: &[f64]) {
    sum.iter_mut().zip(v).for_each(|(s, v)| *s += factor * v);
}

#[cfg(test)]
mod tests;
