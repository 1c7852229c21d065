//! Profiles between the records: a smooth model of the dictionary that also averages its noise.
//!
//! The coordinates are those in which profiles change most evenly: ln σ_t; √(1 − α), to which diffusion is linear; and
//! ln(1 − g), in which similar media lie on straight lines. Across σ_t and g, where every record of a thickness has walks of its own,
//! a local model is fitted by weighted least squares, which averages the noise of the records about; across
//! albedos, which share their walks, the four nearest are interpolated.

use optics_model::{Grid, Medium};

use super::dictionary::FitDictionary;
use super::local_axis::{BACKSCATTERED, Direction, LocalAxis, Weights};
use super::wide::wide;

/// Position in (ln σ_t, √(1 − α), ln(1 − g)).
pub(super) type Coordinates = [f64; 3];
pub(super) const SIGMA_T: usize = 0;
pub(super) const ALBEDO: usize = 1;
pub(super) const G: usize = 2;

pub(super) fn coordinates(medium: &Medium) -> Coordinates {
    [medium.sigma_t_per_mm().ln(), (1.0 - medium.albedo()).sqrt(), (1.0 - medium.g()).ln()]
}

pub(super) fn sigma_t(ln_sigma_t: f64) -> f64 {
    ln_sigma_t.exp()
}

pub(super) fn albedo(root_co_albedo: f64) -> f64 {
    1.0 - root_co_albedo * root_co_albedo
}

pub(super) fn g(ln_one_minus_g: f64) -> f64 {
    1.0 - ln_one_minus_g.exp()
}

/// Cubic interpolation between the four nearest nodes, or all if there are fewer. `nodes` fall.
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

/// Share of walks that go on to another scattering, q. Assumed: slabs thin and thick lie on either side of it.
const SCATTERED_ON: f64 = 0.9;

/// The records' noise in a prediction, as far as the records about show it.
#[derive(Debug)]
pub(super) struct NoiseFactors {
    /// Profiles f_k: Σ f_k f_kᵀ is the covariance.
    pub factors: Vec<Vec<f64>>,
    /// Of how many independent profiles it was estimated.
    pub degrees: f64,
}

/// Where a prediction's noise comes from.
#[derive(Debug)]
pub(super) struct NoisePlace {
    ior: usize,
    albedo: f64,
    /// Optical thickness at every σ_t: records that have it in common have the same walks.
    depths: Vec<f32>,
    sigma_t: Direction,
    g: Direction,
}

impl NoisePlace {
    /// How alike the records' noise is in two predictions, as a correlation: which walks they share, and how alike the
    /// same walks are with both albedos. Records that are optically as thick share their walks, and so do channels. Where
    /// numbers of scatterings n are distributed like qⁿ, the correlation of Σ αⁿ over walks is
    /// √((1 − qα²)(1 − qα′²))/(1 − qαα′).
    pub(super) fn in_common(&self, other: &Self) -> f64 {
        if self.ior != other.ior {
            return 0.0;
        }
        let (a, b) = (self.albedo, other.albedo);
        let left = |product: f64| 1.0 - SCATTERED_ON * product;
        let of_walks = (left(a * a) * left(b * b)).sqrt() / left(a * b);
        let same_walks = |node: usize, of_other: usize| self.depths[node] == other.depths[of_other];
        of_walks * self.sigma_t.cosine_where(&other.sigma_t, same_walks) * self.g.cosine(&other.g)
    }
}

/// A profile between the records and its derivatives by the coordinates.
#[derive(Debug, Clone)]
pub(super) struct Prediction {
    pub values: Vec<f64>,
    pub slopes: [Vec<f64>; 3],
}

/// The model of one channel at one refractive index of the sample.
#[derive(Debug)]
pub(super) struct Surrogate<'a> {
    dictionary: &'a FitDictionary,
    channel: usize,
    ior: usize,
    sigma_t: LocalAxis,
    g: LocalAxis,
    /// √(1 − α), falling.
    albedo: Vec<f64>,
}

impl<'a> Surrogate<'a> {
    pub(super) fn new(dictionary: &'a FitDictionary, channel: usize, ior: usize) -> Self {
        let grid = dictionary.grid();
        let sigma_t = grid.sigma_t_per_mm().iter().map(|v| v.ln()).collect();
        let g = grid.g().iter().map(|v| (1.0 - v).ln()).collect();
        let albedo = grid.albedo().iter().map(|v| (1.0 - v).sqrt()).collect();
        Self {
            dictionary,
            channel,
            ior,
            sigma_t: LocalAxis::new(sigma_t, 0.75),
            g: LocalAxis::with_shapes(g, 1.0, &BACKSCATTERED),
            albedo,
        }
    }

    /// The same over a board whose ρ were measured with a darker white reference, if the scene tells.
    pub(super) fn under_darker_white(&self) -> Option<Self> {
        let channel = self.grid().scene().under_darker_white(self.channel)?;
        Some(Self::new(self.dictionary, channel, self.ior))
    }

    pub(super) fn grid(&self) -> &'a Grid {
        self.dictionary.grid()
    }

    /// Pixels of the dictionary's profiles.
    pub(super) fn pixels(&self) -> usize {
        self.grid().scene().sensor().pixels()
    }

    /// Index of the sample's refractive index.
    pub(super) fn ior(&self) -> usize {
        self.ior
    }

    /// Least and greatest value of each coordinate.
    pub(super) fn limits(&self) -> [(f64, f64); 3] {
        let albedo = (self.albedo[self.albedo.len() - 1], self.albedo[0]);
        [self.sigma_t.range(), albedo, self.g.range()]
    }

    fn row(&self, sigma_t: usize, g: usize, thickness: usize, albedo: usize) -> &[f32] {
        let record = self.dictionary.grid().record_at(self.ior, sigma_t, g, thickness, albedo);
        self.dictionary.values(record, self.channel)
    }

    pub(super) fn predict(
        &self,
        thickness: usize,
        pixels: std::ops::Range<usize>,
        x: Coordinates,
    ) -> Prediction {
        self.dictionary.stop.check();
        let s = self.sigma_t.weights(x[SIGMA_T]);
        let a = interpolation(&self.albedo, x[ALBEDO]);
        let g = self.g.weights(x[G]);
        let zero = || vec![0.0; pixels.len()];
        let mut values = zero();
        let mut slopes = [zero(), zero(), zero()];
        // At most four; the others weigh nothing.
        let weights_of = |weights: &[f64]| std::array::from_fn(|j| weights.get(j).copied().unwrap_or(0.0));
        let albedos = AlbedoWeights { values: weights_of(&a.values), slopes: weights_of(&a.slopes) };
        let mut nodes = Vec::with_capacity(g.values.len());
        for i in 0..s.values.len() {
            nodes.clear();
            nodes.extend((0..g.values.len()).map(|k| {
                let rows = std::array::from_fn(|j| {
                    let albedo = a.first + j.min(a.values.len() - 1);
                    &self.row(s.first + i, g.first + k, thickness, albedo)[pixels.clone()]
                });
                Node { rows, weight: g.values[k], slope: g.slopes[k] }
            }));
            let sigma_t = (s.values[i], s.slopes[i]);
            wide(
                #[inline(always)]
                || accumulate(&nodes, &albedos, sigma_t, &mut values, &mut slopes),
            );
        }
        Prediction { values, slopes }
    }

    /// The same at any thickness near one of the dictionary's.
    pub(super) fn noise_factors_at(&self, thickness_mm: f64, x: Coordinates) -> NoiseFactors {
        let (index, ratio) = self.nearest_thickness(thickness_mm);
        self.noise_factors(index, [x[SIGMA_T] + ratio.ln(), x[ALBEDO], x[G]])
    }

    /// Index of the dictionary's nearest thickness, and the factor from it.
    fn nearest_thickness(&self, thickness_mm: f64) -> (usize, f64) {
        let axis = self.dictionary.grid().thickness_mm();
        let off = |t: &f64| (thickness_mm / t).ln().abs();
        let nearest = axis.iter().enumerate().min_by(|a, b| off(a.1).total_cmp(&off(b.1)));
        nearest.map_or((0, 1.0), |(index, nominal)| (index, thickness_mm / nominal))
    }

    /// What the records' noise in a prediction is made of.
    pub(super) fn noise_at(&self, thickness_mm: f64, x: Coordinates) -> NoisePlace {
        let (thickness, ratio) = self.nearest_thickness(thickness_mm);
        let thickness_mm = self.grid().thickness_mm()[thickness];
        let depth = |sigma_t: &f64| (sigma_t * thickness_mm) as f32;
        NoisePlace {
            ior: self.ior,
            depths: self.grid().sigma_t_per_mm().iter().map(depth).collect(),
            albedo: albedo(x[ALBEDO]).clamp(0.0, 1.0),
            sigma_t: self.sigma_t.direction(x[SIGMA_T] + ratio.ln()),
            g: self.g.direction(x[G]),
        }
    }

    /// Records about `x` and what the model takes of each: number of the medium over all axes, weight, and the weight's
    /// derivatives by the coordinates.
    pub(super) fn stencil(&self, x: Coordinates) -> Vec<(usize, f64, [f64; 3])> {
        self.dictionary.stop.check();
        let (s, g) = (self.sigma_t.weights(x[SIGMA_T]), self.g.weights(x[G]));
        let a = interpolation(&self.albedo, x[ALBEDO]);
        let grid = self.dictionary.grid();
        let mut stencil = Vec::with_capacity(s.values.len() * g.values.len() * a.values.len());
        for i in 0..s.values.len() {
            let row = self.ior * grid.sigma_t_per_mm().len() + s.first + i;
            for k in 0..g.values.len() {
                let first = (row * grid.g().len() + g.first + k) * grid.albedo().len() + a.first;
                for j in 0..a.values.len() {
                    let by = [
                        s.slopes[i] * a.values[j] * g.values[k],
                        s.values[i] * a.slopes[j] * g.values[k],
                        s.values[i] * a.values[j] * g.slopes[k],
                    ];
                    stencil.push((first + j, s.values[i] * a.values[j] * g.values[k], by));
                }
            }
        }
        stencil
    }

    /// Profiles f_k such that Σ f_k f_kᵀ is the covariance that the records' noise gives to the model at `x`, over all
    /// pixels: what the local model leaves of the records about.
    fn noise_factors(&self, thickness: usize, x: Coordinates) -> NoiseFactors {
        let a = interpolation(&self.albedo, x[ALBEDO]);
        let (first_s, window_s, hat_s) = self.sigma_t.hat(x[SIGMA_T]);
        let (first_g, window_g, hat_g) = self.g.hat(x[G]);
        let (ns, ng) = (window_s.len(), window_g.len());
        let pixels = self.dictionary.grid().scene().sensor().pixels();
        let image = |n: usize| -> Vec<f64> {
            let mut image = vec![0.0; pixels];
            for (j, weight) in a.values.iter().enumerate() {
                let row = self.row(first_s + n / ng, first_g + n % ng, thickness, a.first + j);
                image.iter_mut().zip(row).for_each(|(v, r)| *v += weight * f64::from(*r));
            }
            image
        };
        let images: Vec<Vec<f64>> = (0..ns * ng).map(image).collect();
        let add = |into: &mut [f64], factor: f64, of: &[f64]| {
            into.iter_mut().zip(of).for_each(|(v, o)| *v += factor * o);
        };
        // The models along both axes, one after the other.
        let along_s: Vec<Vec<f64>> = (0..ns * ng)
            .map(|n| {
                let mut smooth = vec![0.0; pixels];
                (0..ns).for_each(|m| add(&mut smooth, hat_s[n / ng][m], &images[m * ng + n % ng]));
                smooth
            })
            .collect();
        let square = |w: &Weights| w.values.iter().map(|w| w * w).sum::<f64>();
        let leverage = square(&self.sigma_t.weights(x[SIGMA_T])) * square(&self.g.weights(x[G]));
        let (mut factors, mut total) = (Vec::new(), 0.0);
        // Of the weights: sum of squares; of the rests: sum of variances.
        let (mut squared, mut free) = (0.0, 0.0);
        for (n, image) in images.iter().enumerate() {
            let (i, k) = (n / ng, n % ng);
            let mut rest = image.clone();
            (0..ng).for_each(|m| add(&mut rest, -hat_g[k][m], &along_s[i * ng + m]));
            let squares =
                hat_s[i].iter().map(|h| h * h).sum::<f64>() * hat_g[k].iter().map(|h| h * h).sum::<f64>();
            // Variance of a rest over that of a record.
            let left = 1.0 - 2.0 * hat_s[i][i] * hat_g[k][k] + squares;
            if left < 1e-6 {
                continue;
            }
            let weight = window_s[i] * window_g[k];
            total += weight;
            squared += weight * weight;
            free += left;
            let size = (weight * leverage / left).sqrt();
            for v in &mut rest {
                *v *= size;
            }
            factors.push(rest);
        }
        let size = if total > 0.0 { total.sqrt().recip() } else { 0.0 };
        factors.iter_mut().flatten().for_each(|v| *v *= size);
        let records = if squared > 0.0 { total * total / squared } else { 0.0 };
        let degrees = records * free / factors.len().max(1) as f64;
        NoiseFactors { factors, degrees }
    }

    /// What the records' noise does to `N` functionals of the model's profile at `x`: their covariance.
    ///
    /// The noise is read off the records about: what the local model leaves of them is noise, and a little of the
    /// model's own failure. `functionals` are weights of the pixels of `pixels`.
    pub(super) fn noise<const N: usize>(
        &self,
        thickness: usize,
        pixels: &std::ops::Range<usize>,
        x: Coordinates,
        functionals: &[Vec<f64>; N],
    ) -> [[f64; N]; N] {
        let a = interpolation(&self.albedo, x[ALBEDO]);
        let (first_s, window_s, hat_s) = self.sigma_t.hat(x[SIGMA_T]);
        let (first_g, window_g, hat_g) = self.g.hat(x[G]);
        let image = |s: usize, g: usize| -> [f64; N] {
            let mut image = [0.0; N];
            for (j, weight) in a.values.iter().enumerate() {
                let row = &self.row(first_s + s, first_g + g, thickness, a.first + j)[pixels.clone()];
                for (out, f) in image.iter_mut().zip(functionals) {
                    *out += weight * row.iter().zip(f).map(|(v, f)| f64::from(*v) * f).sum::<f64>();
                }
            }
            image
        };
        let (ns, ng) = (window_s.len(), window_g.len());
        let images: Vec<[f64; N]> = (0..ns * ng).map(|n| image(n / ng, n % ng)).collect();
        let mut scatter = [[0.0; N]; N];
        let mut total = 0.0;
        for i in 0..ns {
            for k in 0..ng {
                let mut rest = images[i * ng + k];
                let mut squares = 0.0;
                for (m, image) in images.iter().enumerate() {
                    let h = hat_s[i][m / ng] * hat_g[k][m % ng];
                    squares += h * h;
                    (0..N).for_each(|c| rest[c] -= h * image[c]);
                }
                // Variance of a rest over that of a record.
                let left = 1.0 - 2.0 * hat_s[i][i] * hat_g[k][k] + squares;
                if left < 1e-6 {
                    continue;
                }
                let weight = window_s[i] * window_g[k];
                total += weight;
                add_outer(&mut scatter, rest, weight / left);
            }
        }
        if total == 0.0 {
            return scatter;
        }
        let square = |w: Weights| w.values.iter().map(|w| w * w).sum::<f64>();
        let leverage = square(self.sigma_t.weights(x[SIGMA_T])) * square(self.g.weights(x[G]));
        scatter.map(|row| row.map(|v| v * leverage / total))
    }
}

/// Adds factor · v vᵀ.
fn add_outer<const N: usize>(matrix: &mut [[f64; N]; N], v: [f64; N], factor: f64) {
    for (row, a) in matrix.iter_mut().zip(v) {
        for (cell, b) in row.iter_mut().zip(v) {
            *cell += factor * a * b;
        }
    }
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

/// Pixels that are summed up at a time: as many as vector registers hold.
const BLOCK: usize = 8;

/// Adds what the records of one σ_t contribute to a value and its derivatives. `sigma_t` is the weight of this σ_t and its
/// derivative.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn accumulate(
    nodes: &[Node],
    albedos: &AlbedoWeights,
    sigma_t: (f64, f64),
    values: &mut [f64],
    slopes: &mut [Vec<f64>; 3],
) {
    let whole = values.len() / BLOCK * BLOCK;
    for at in (0..whole).step_by(BLOCK) {
        accumulate_block::<BLOCK>(nodes, albedos, sigma_t, at, values, slopes);
    }
    for at in whole..values.len() {
        accumulate_block::<1>(nodes, albedos, sigma_t, at, values, slopes);
    }
}

/// The same for the pixels of one block.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn accumulate_block<const N: usize>(
    nodes: &[Node],
    albedos: &AlbedoWeights,
    sigma_t: (f64, f64),
    at: usize,
    values: &mut [f64],
    slopes: &mut [Vec<f64>; 3],
) {
    // The value at this σ_t, and its derivatives by √(1 − α) and ln(1 − g).
    let (mut value, mut by_albedo, mut by_g) = ([0.0; N], [0.0; N], [0.0; N]);
    let mix = |v: [f64; 4], w: &[f64; 4]| v[0] * w[0] + v[1] * w[1] + v[2] * w[2] + v[3] * w[3];
    for node in nodes {
        let rows: [&[f32; N]; 4] =
            node.rows.map(|row| row[at..].first_chunk().expect("rows are as long as the values"));
        for p in 0..N {
            let v = rows.map(|row| f64::from(row[p]));
            let mixed = mix(v, &albedos.values);
            value[p] += node.weight * mixed;
            by_albedo[p] += node.weight * mix(v, &albedos.slopes);
            by_g[p] += node.slope * mixed;
        }
    }
    let (weight, slope) = sigma_t;
    let [by_sigma_t_out, by_albedo_out, by_g_out] = slopes;
    let outs = [
        (values, weight, &value),
        (&mut by_sigma_t_out[..], slope, &value),
        (&mut by_albedo_out[..], weight, &by_albedo),
        (&mut by_g_out[..], weight, &by_g),
    ];
    for (out, factor, sum) in outs {
        add_scaled(&mut out[at..at + N], factor, sum);
    }
}

/// Adds factor · v.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
pub(super) fn add_scaled(sum: &mut [f64], factor: f64, v: &[f64]) {
    sum.iter_mut().zip(v).for_each(|(s, v)| *s += factor * v);
}

#[cfg(test)]
mod tests;
