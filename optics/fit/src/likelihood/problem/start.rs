//! Finds starting points from which the descent ends at the lowest minimum over the whole dictionary.
//!
//! Every medium of the dictionary is compared: with its profiles in a basis of a few directions (`sketch`), −2 ln L is a
//! quadratic form in their coefficients, once gain, zero, slope, origin and blur are integrated out with their priors.
//! The columns of these are taken from the measurement itself, smoothed, and so are the same for all media. A minimum of
//! the continuous likelihood lies next to a medium that is lower than its neighbours along all axes. From every such
//! medium within a limit a descent in the basis, between the records, finds that minimum; the lowest of them are the
//! starting points of the full likelihood. The test `descent_finds_the_global_minimum` compares with descents from all
//! over the dictionary.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Vector3};
use optics_model::MeasuredProfile;
use optics_model::descent::{Descent, DescentStep};
use optics_model::fit::FitSettings;

use crate::dictionary::FitDictionary;
use crate::dictionary::view::View;
use crate::dictionary::wide::wide;
use crate::likelihood::point::Line;
use crate::likelihood::problem::form::{QuadraticForm, loose_columns, smoothed};
use crate::likelihood::term::robust::without_specks;
use crate::surrogate::resample::resample;
use crate::surrogate::{Neighbours, Surrogate};

/// Least relative error of the basis and of the records.
const FLOOR: f64 = 0.003;
/// Number of media that are compared side by side.
const BLOCK: usize = 256;
/// Maximum number of minima that are followed.
const MINIMA: usize = 24;
/// A minimum of media is not followed if it is higher than the lowest by this factor, and by this much.
const HOPELESS: (f64, f64) = (4.0, 200.0);
/// Descents in the basis.
const DESCENT: Descent = Descent { most_steps: 12, tolerance: 0.01 };

/// A profile to be compressed; its values and errors are multiplied by μ.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source<'a> {
    pub profile: &'a MeasuredProfile,
    pub origin_mm: f64,
    pub set_up: &'a FitSettings,
    /// Standard error of a factor on μ, in addition to the profile's gain.
    pub scale_std_error: f64,
    pub std_errors: &'a [f64],
}

/// One profile as a quadratic form in the coefficients of the basis.
#[derive(Debug)]
pub(crate) struct Compressed {
    /// Index into the grid's thicknesses, and ln of the slab's thickness over it.
    thickness: usize,
    ln_ratio: f64,
    /// Lᵀ of the form K = L Lᵀ, row by row.
    root: DMatrix<f64>,
    /// L⁻¹ times the part of the measurement, and times that of the basis' mean profile.
    data: DVector<f64>,
    mean: DVector<f64>,
    /// The cost that no medium explains, as a quadratic in the scale: coefficients of 1, s, s².
    left: [f64; 3],
}

/// A starting point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    pub medium: [f64; 3],
    pub ior: usize,
    pub cost: f64,
}

impl Compressed {
    /// None if the profile covers nothing, or its basis is singular.
    pub(crate) fn new(dictionary: &FitDictionary, view: &View, source: &Source) -> Option<Self> {
        let Source { profile, origin_mm, set_up, scale_std_error, std_errors } = *source;
        let mu = set_up.mu;
        let axis = dictionary.grid().thickness_mm();
        let off = |t: &f64| libm::log(profile.thickness_mm() / t).abs();
        let (thickness, nominal) = axis.iter().enumerate().min_by(|a, b| off(a.1).total_cmp(&off(b.1)))?;
        let ratio = profile.thickness_mm() / nominal;
        let x: Line = profile.x_mm().iter().map(|x| (x - origin_mm) / ratio).collect();
        let calm = without_specks(profile.values(), std_errors);
        let sensor = dictionary.grid().scene().sensor();
        let resampled = resample(&x, profile.values(), sensor);
        if resampled.values.is_empty() {
            return None;
        }
        let variances = resampled.variances(
            &std_errors.iter().zip(&calm).map(|(e, c)| if *c { *e } else { 1e6 }).collect::<Line>(),
        );
        let pixels = resampled.pixels.clone();
        let values: Line = resampled.values.iter().map(|v| v * mu).collect();
        let weights: Line = variances
            .iter()
            .zip(&values)
            .map(|(variance, v)| 1.0 / (variance * mu * mu + (FLOOR * v).powi(2) + 1e-10))
            .collect();
        let basis = view.value_basis();
        let part = |f: &[f64]| f[pixels.clone()].to_vec();
        let directions: Vec<Line> = basis.directions().iter().map(|d| part(d)).collect();
        let mean = part(basis.mean());
        let smooth = smoothed(&values, &weights, &directions, &mean)?;
        let gain = libm::hypot(set_up.gain_std_error, scale_std_error);
        let columns = loose_columns(&smooth, sensor, pixels.start, set_up, gain, ratio);
        let form = QuadraticForm::new(&weights, &columns)?;
        let k = DMatrix::from_fn(directions.len(), directions.len(), |i, j| {
            form.of(&directions[i], &directions[j])
        });
        let trace = k.trace();
        let root =
            Cholesky::new(k + DMatrix::identity(directions.len(), directions.len()) * (1e-12 * trace))?;
        let onto = |f: &[f64]| {
            let b = DVector::from_iterator(directions.len(), directions.iter().map(|d| form.of(d, f)));
            root.l().solve_lower_triangular(&b)
        };
        let (data, mean_part) = (onto(&values)?, onto(&mean)?);
        let left = [
            form.of(&values, &values) - data.dot(&data),
            -2.0 * (form.of(&values, &mean) - data.dot(&mean_part)),
            form.of(&mean, &mean) - mean_part.dot(&mean_part),
        ];
        let ln_ratio = libm::log(ratio);
        Some(Self { thickness, ln_ratio, root: root.l().transpose(), data, mean: mean_part, left })
    }

    /// Index into the grid's thicknesses.
    pub(crate) fn thickness(&self) -> usize {
        self.thickness
    }

    fn left(&self, scale: f64) -> f64 {
        (self.left[0] + scale * (self.left[1] + scale * self.left[2])).max(0.0)
    }

    /// Adds the cost of all media of the dictionary, with their profiles multiplied by a scale.
    #[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
    #[inline(always)]
    fn add_costs(&self, view: &View, scale: f64, costs: &mut [f32]) {
        let sketch = view.value_sketch(self.thickness);
        let n = self.data.len();
        let left = self.left(scale) as f32;
        let (mut sums, mut z) = ([0.0_f32; BLOCK], [0.0_f32; BLOCK]);
        for (block, costs) in costs.chunks_mut(BLOCK).enumerate() {
            let media = block * BLOCK..block * BLOCK + costs.len();
            let (sums, z) = (&mut sums[..costs.len()], &mut z[..costs.len()]);
            sums.fill(left);
            for i in 0..n {
                z.fill((scale * self.mean[i] - self.data[i]) as f32);
                for j in i..n {
                    let factor = (scale * self.root[(i, j)] * view.sketch_scale()) as f32;
                    for (z, c) in z.iter_mut().zip(&sketch.row(j)[media.clone()]) {
                        *z += factor * c;
                    }
                }
                sums.iter_mut().zip(&*z).for_each(|(s, z)| *s += z * z);
            }
            costs.iter_mut().zip(&*sums).for_each(|(c, s)| *c += s);
        }
    }

    /// Residuals in the basis between the records, and their derivatives by the medium.
    fn residuals(
        &self,
        view: &View,
        surrogate: &Surrogate,
        near: &Neighbours,
        scale: f64,
    ) -> (DVector<f64>, DMatrix<f64>) {
        let sketch = view.value_sketch(self.thickness);
        let n = self.data.len();
        let mut all = DMatrix::zeros(n, 4);
        for k in 0..n {
            all.row_mut(k).copy_from_slice(&surrogate.sums(near, sketch.row(k)));
        }
        let through = &self.root * all * (scale * view.sketch_scale());
        let residuals = through.column(0) + scale * &self.mean - &self.data;
        (residuals, through.columns(1, 3).clone_owned())
    }
}

/// The limits of a search.
#[derive(Debug, Clone)]
pub(crate) struct Region {
    /// As in `Admissible`, by index of the axes.
    pub admissible: crate::dictionary::axes::Admissible,
    pub limits: [(f64, f64); 3],
    pub held: [bool; 3],
}

/// One channel, ready to be searched.
#[derive(Debug)]
pub(crate) struct Scan<'a> {
    pub dictionary: &'a FitDictionary,
    pub view: std::sync::Arc<View>,
    pub terms: Vec<Compressed>,
    pub region: Region,
}

impl Scan<'_> {
    /// Costs of all media, in the order of their numbers.
    pub(crate) fn costs(&self, scale: f64) -> Vec<f32> {
        let grid = self.dictionary.grid();
        let media = grid.record_count() / grid.thickness_mm().len();
        let mut costs = vec![0.0; media];
        for term in &self.terms {
            self.dictionary.stop.check();
            wide(
                #[inline(always)]
                || term.add_costs(&self.view, scale, &mut costs),
            );
        }
        costs
    }

    /// Number of a medium over all axes.
    pub(crate) fn number(&self, [ior, s, g, a]: [usize; 4]) -> usize {
        let grid = self.dictionary.grid();
        ((ior * grid.sigma_t_per_mm().len() + s) * grid.g().len() + g) * grid.albedo().len() + a
    }

    /// Admissible media, best first, at most `count`.
    pub(crate) fn best(&self, costs: &[f32], count: usize) -> Vec<[usize; 4]> {
        let mut media = self.media(0..self.dictionary.grid().sample_ior().len());
        let better = |a: &[usize; 4], b: &[usize; 4]| {
            costs[self.number(*a)].total_cmp(&costs[self.number(*b)]).then(a.cmp(b))
        };
        if (1..media.len()).contains(&count) {
            media.select_nth_unstable_by(count - 1, better);
        }
        media.truncate(count);
        media.sort_unstable_by(better);
        media
    }

    fn media(&self, iors: std::ops::Range<usize>) -> Vec<[usize; 4]> {
        let region = &self.region.admissible;
        let mut media = Vec::new();
        for ior in iors {
            for s in region.sigma_t.clone() {
                for g in region.g.clone() {
                    media.extend(region.albedo.clone().map(|a| [ior, s, g, a]));
                }
            }
        }
        media
    }

    /// Media that are lower than all their neighbours, lowest first.
    fn minima(&self, costs: &[f32]) -> Vec<[usize; 4]> {
        let region = &self.region.admissible;
        let cost = |m: [usize; 4]| costs[self.number(m)];
        let around = |i: usize, range: &std::ops::Range<usize>| {
            i.saturating_sub(1).max(range.start)..(i + 2).min(range.end)
        };
        let lowest = |m: &[usize; 4]| {
            let [ior, s, g, a] = *m;
            let own = cost(*m);
            around(s, &region.sigma_t).all(|s| {
                around(g, &region.g).all(|g| around(a, &region.albedo).all(|a| cost([ior, s, g, a]) >= own))
            })
        };
        let mut minima: Vec<[usize; 4]> =
            self.media(0..self.dictionary.grid().sample_ior().len()).into_iter().filter(lowest).collect();
        minima.sort_by(|a, b| cost(*a).total_cmp(&cost(*b)));
        let best = minima.first().map_or(0.0, |m| f64::from(cost(*m)));
        let hopeless = (HOPELESS.0 * best).max(best + HOPELESS.1);
        minima.retain(|m| f64::from(cost(*m)) <= hopeless);
        minima.truncate(MINIMA);
        minima
    }

    /// Coordinates of a medium of the grid, within the limits.
    fn coordinates(&self, [_, s, g, a]: [usize; 4]) -> [f64; 3] {
        let grid = self.dictionary.grid();
        let x = [
            libm::log(grid.sigma_t_per_mm()[s]),
            (1.0 - grid.albedo()[a]).sqrt(),
            libm::log(1.0 - grid.g()[g]),
        ];
        std::array::from_fn(|i| x[i].clamp(self.region.limits[i].0, self.region.limits[i].1))
    }

    /// The minima of the likelihood in the basis, lowest first, each once.
    pub(crate) fn starts(&self, surrogates: &[Surrogate], scale: f64) -> Vec<Start> {
        let costs = self.costs(scale);
        let mut starts: Vec<Start> = Vec::new();
        let mut found: Vec<Start> = self
            .minima(&costs)
            .into_iter()
            .map(|m| self.descend(&surrogates[m[0]], m[0], self.coordinates(m), self.region.held, scale))
            .collect();
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        for start in found {
            let near = |other: &Start| {
                other.ior == start.ior && (0..3).all(|i| (other.medium[i] - start.medium[i]).abs() < 0.02)
            };
            if !starts.iter().any(near) {
                starts.push(start);
            }
        }
        starts
    }

    /// The lowest start with the anisotropy at each node of the dictionary, at one scale.
    pub(crate) fn by_anisotropy(&self, surrogates: &[Surrogate], costs: &[f32], scale: f64) -> Vec<Start> {
        let region = &self.region.admissible;
        let best = |g: usize| {
            let row = |s: usize| region.albedo.clone().map(move |a| [0, s, g, a]);
            region
                .sigma_t
                .clone()
                .flat_map(row)
                .min_by(|a, b| costs[self.number(*a)].total_cmp(&costs[self.number(*b)]))
        };
        let held = [self.region.held[0], self.region.held[1], true];
        let start = |m: [usize; 4]| self.descend(&surrogates[m[0]], m[0], self.coordinates(m), held, scale);
        region.g.clone().filter_map(best).map(start).collect()
    }

    /// The minimum in the basis below a place.
    fn descend(&self, surrogate: &Surrogate, ior: usize, x: [f64; 3], held: [bool; 3], scale: f64) -> Start {
        let start = self.parabola(surrogate, x, scale);
        let step = |from: &Parabola, damping: f64| {
            let to = self.step(from, held, damping)?;
            Some(DescentStep { predicted: from.fall(to), to: self.parabola(surrogate, to, scale) })
        };
        let decrement = |from: &Parabola| self.step(from, held, 0.0).map(|to| from.fall(to));
        let found = DESCENT.damped(start, |p| p.cost, decrement, step).at;
        Start { medium: found.x, ior, cost: found.cost }
    }

    /// −2 ln L at a place, with half of its derivatives there.
    fn parabola(&self, surrogate: &Surrogate, x: [f64; 3], scale: f64) -> Parabola {
        let cost = self.terms.iter().map(|t| t.left(scale)).sum();
        let mut all = Parabola { x, cost, downhill: Vector3::zeros(), normal: Matrix3::zeros() };
        let near = surrogate.neighbours(x);
        for term in &self.terms {
            let moved = (term.ln_ratio != 0.0).then(|| surrogate.at_sigma_t(&near, x[0] + term.ln_ratio));
            let (residuals, slopes) =
                term.residuals(&self.view, surrogate, moved.as_ref().unwrap_or(&near), scale);
            all.cost += residuals.dot(&residuals);
            all.downhill -= Vector3::from_iterator((slopes.transpose() * &residuals).iter().copied());
            let square = slopes.transpose() * &slopes;
            all.normal += Matrix3::from_fn(|i, j| square[(i, j)]);
        }
        all
    }

    /// The end of a damped step that does not leave the limits.
    fn step(&self, from: &Parabola, held: [bool; 3], damping: f64) -> Option<[f64; 3]> {
        let (x, mut matrix, mut pull) = (from.x, from.normal, from.downhill);
        for i in 0..3 {
            let (low, high) = self.region.limits[i];
            let out = (x[i] <= low && pull[i] < 0.0) || (x[i] >= high && pull[i] > 0.0);
            matrix[(i, i)] = matrix[(i, i)] * (1.0 + damping) + 1e-9;
            if held[i] || out {
                for j in 0..3 {
                    (matrix[(i, j)], matrix[(j, i)]) = (0.0, 0.0);
                }
                (matrix[(i, i)], pull[i]) = (1.0, 0.0);
            }
        }
        let step = matrix.try_inverse()? * pull;
        let limits = &self.region.limits;
        Some(std::array::from_fn(|i| (x[i] + step[i]).clamp(limits[i].0, limits[i].1)))
    }
}

/// −2 ln L in the basis at a place, and half of its derivatives by the medium.
struct Parabola {
    x: [f64; 3],
    cost: f64,
    downhill: Vector3<f64>,
    normal: Matrix3<f64>,
}

impl Parabola {
    /// The fall of −2 ln L that the quadratic predicts on the way to another place.
    fn fall(&self, to: [f64; 3]) -> f64 {
        let step = Vector3::from(to) - Vector3::from(self.x);
        2.0 * self.downhill.dot(&step) - step.dot(&(self.normal * step))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fall along (1, 1, 1): twice the pull's 6, less the form's 4.
    #[test]
    fn parabola_promises_its_own_fall() {
        let downhill = Vector3::new(1.0, 2.0, 3.0);
        let normal = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 2.0));
        let parabola = Parabola { x: [0.5; 3], cost: 0.0, downhill, normal };
        assert_eq!(parabola.fall([1.5; 3]), 8.0);
    }
}
