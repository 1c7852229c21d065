//! The least-squares problem of a chart: residuals of its patches with their errors, normal equations, and the descent.

use std::sync::OnceLock;

use libm::log;
use nalgebra::{DMatrix, DVector};
use optics_model::descent::{Descended, Descent, DescentStep};

use crate::camera::{self, Matrix};
use crate::forward::{self, PatchLook, PatchSlopes, PatchValues};
use crate::unknowns::{ChartUnknowns, OF_LIGHT};
use crate::{Chart, StackPatch};

/// Errors of the model at the beginning, and of few patches: in ΔE₀₀ for colours, and as shares of radiance factors.
pub(crate) const FIRST_ERROR: [f64; 2] = [1.5, 0.05];
/// Fewest stacks whose residuals show the error of the model.
pub(crate) const FEWEST_HELD_OUT: usize = 20;
/// Least errors of the model: in ΔE₀₀, and as a share.
const LEAST_ERROR: [f64; 2] = [0.05, 0.001];
/// Least value whose logarithm is compared.
const DARKEST: f64 = 1e-3;
/// Step of numeric slopes of an observation.
const STEP: f64 = 1e-5;
/// Most change of a number in one step: of a logarithm, for media.
const LONGEST_STEP: f64 = 2.0;
/// Factors on the media of the first descents.
const STARTS: [f64; 3] = [0.4, 1.0, 2.5];
/// Descents without a part of the patches, and the first ones.
const REFIT: Descent = Descent { most_steps: 8, tolerance: 0.5 };
const COARSE_DESCENT: Descent = Descent { most_steps: 25, tolerance: 2.0 };

/// A place of the descent.
#[derive(Debug)]
pub(crate) struct FitPlace {
    pub at: DVector<f64>,
    pub values: PatchValues,
    residuals: Vec<DVector<f64>>,
    pub cost: f64,
    normal: OnceLock<Option<ChartEquations>>,
}

/// The sums of the normal equations; each patch's own part is kept for cross-validation.
#[derive(Debug)]
pub(crate) struct ChartEquations {
    pub matrix: DMatrix<f64>,
    pub gradient: DVector<f64>,
    /// Slopes of each patch's residuals, with the places of their columns, whitened, and the residuals.
    pub parts: Vec<(Vec<usize>, DMatrix<f64>, DVector<f64>)>,
}

pub(crate) struct Problem<'a> {
    pub chart: &'a Chart,
    pub unknowns: ChartUnknowns,
    pub looks: Vec<PatchLook>,
    pub mean: DVector<f64>,
    pub precision: DMatrix<f64>,
    /// Values over all directions less those over few.
    pub correction: PatchValues,
    /// Covariance of the model's error.
    pub model_error: DMatrix<f64>,
}

impl Problem<'_> {
    /// The lowest place of descents from media that scatter less, as much, and more than usual: the cost has several minima.
    pub(crate) fn best_start(&self) -> Option<DVector<f64>> {
        let place = |factor: &f64| {
            let start = self.unknowns.scaled(&self.mean, *factor);
            self.descended(start, COARSE_DESCENT).at
        };
        let places = STARTS.iter().map(place);
        places.min_by(|a, b| a.cost.total_cmp(&b.cost)).map(|place| place.at)
    }

    pub(crate) fn descended(&self, start: DVector<f64>, descent: Descent) -> Descended<FitPlace> {
        let decrement = |place: &FitPlace| {
            let (gradient, step) = self.step(place, 0.0)?;
            Some(-gradient.dot(&step))
        };
        let step = |place: &FitPlace, damping: f64| {
            let (gradient, step) = self.step(place, damping)?;
            let to = self.place(self.limited(&place.at + &step));
            let taken = &to.at - &place.at;
            let predicted = -2.0 * gradient.dot(&taken) - taken.dot(&(&place.normal(self)?.matrix * &taken));
            Some(DescentStep { to, predicted: predicted.max(f64::MIN_POSITIVE) })
        };
        descent.damped(self.place(start), |place| place.cost, decrement, step)
    }

    /// The gradient and a damped step, both without numbers that their limits hold.
    fn step(&self, place: &FitPlace, damping: f64) -> Option<(DVector<f64>, DVector<f64>)> {
        let normal = place.normal(self)?;
        self.solved(normal.matrix.clone(), normal.gradient.clone(), &place.at, damping)
    }

    /// The solution of normal equations at a place, without the index and numbers that their limits hold.
    pub(crate) fn solved(
        &self,
        mut matrix: DMatrix<f64>,
        mut gradient: DVector<f64>,
        at: &DVector<f64>,
        damping: f64,
    ) -> Option<(DVector<f64>, DVector<f64>)> {
        for i in 0..gradient.len() {
            let [least, most] = self.unknowns.limits(i);
            let is_held = at[i] <= least && gradient[i] > 0.0 || at[i] >= most && gradient[i] < 0.0;
            if is_held || i == self.unknowns.ior {
                hold(&mut matrix, i);
                gradient[i] = 0.0;
            }
            matrix[(i, i)] *= 1.0 + damping;
        }
        let mut step = -matrix.cholesky()?.solve(&gradient);
        step.iter_mut().for_each(|v| *v = v.clamp(-LONGEST_STEP, LONGEST_STEP));
        Some((gradient, step))
    }

    /// A few more steps of the fit without some patches, from a place near its minimum.
    pub(crate) fn refitted(&self, without: &[usize], start: DVector<f64>) -> DVector<f64> {
        let kept: Vec<usize> = (0..self.chart.patches.len()).filter(|i| !without.contains(i)).collect();
        let patches = kept.iter().map(|i| self.chart.patches[*i].clone()).collect();
        let chart = Chart { patches, ..self.chart.clone() };
        let all: Vec<usize> = (0..kept.len()).collect();
        let rest = Problem {
            chart: &chart,
            unknowns: self.unknowns.clone(),
            looks: forward::looks(&chart, &all, true),
            mean: self.mean.clone(),
            precision: self.precision.clone(),
            correction: kept.iter().map(|i| self.correction[*i].clone()).collect(),
            model_error: self.model_error.clone(),
        };
        rest.descended(start, REFIT).at.at
    }

    /// Numbers within their limits.
    pub(crate) fn limited(&self, mut at: DVector<f64>) -> DVector<f64> {
        for (place, number) in at.iter_mut().enumerate() {
            let [least, most] = self.unknowns.limits(place);
            *number = number.clamp(least, most);
        }
        at
    }

    pub(crate) fn values(&self, at: &DVector<f64>, looks: &[PatchLook]) -> PatchValues {
        let mut values = forward::values(self.chart, &self.unknowns, looks, at);
        self.add_correction(&mut values);
        values
    }

    fn add_correction(&self, values: &mut PatchValues) {
        for (values, correction) in values.iter_mut().zip(&self.correction) {
            values.iter_mut().zip(correction).for_each(|(value, by)| *value += by);
        }
    }

    pub(crate) fn correct(&mut self, fine: &[PatchLook], at: &DVector<f64>) {
        self.correction = Vec::new();
        let [fine, coarse] = [fine, &self.looks].map(|looks| self.values(at, looks));
        let less = |(fine, coarse): (&Vec<f64>, &Vec<f64>)| {
            fine.iter().zip(coarse).map(|(fine, coarse)| fine - coarse).collect()
        };
        self.correction = fine.iter().zip(&coarse).map(less).collect();
    }

    pub(crate) fn place(&self, at: DVector<f64>) -> FitPlace {
        let values = self.values(&at, &self.looks);
        let one = |(patch, v): (&StackPatch, &Vec<f64>)| self.residual(patch, v, &at);
        let residuals: Vec<DVector<f64>> = self.chart.patches.iter().zip(&values).map(one).collect();
        let from = &at - &self.mean;
        let mut cost = from.dot(&(&self.precision * &from));
        for (patch, residual) in self.chart.patches.iter().zip(&residuals) {
            cost += self.whitened(patch, residual.clone()).norm_squared();
        }
        FitPlace { at, values, residuals, cost, normal: OnceLock::new() }
    }

    /// The expected values of a patch.
    pub(crate) fn observed(&self, patch: &StackPatch, v: &[f64], at: &DVector<f64>) -> Vec<f64> {
        let matrix = self.unknowns.matrix(self.chart, at);
        let light = patch.place.map_or(1.0, |place| light(self.chart, &self.unknowns, at, place));
        let sheen = if self.chart.views[patch.view].has_sheen { at[self.unknowns.sheen] } else { 0.0 };
        seen(v, matrix.as_ref(), sheen, light)
    }

    /// Expected less measured: of colours as ΔE₀₀, else of logarithms.
    fn residual(&self, patch: &StackPatch, v: &[f64], at: &DVector<f64>) -> DVector<f64> {
        residual(self.chart, &patch.values, &self.observed(patch, v, at))
    }

    /// A vector of a patch's residuals, or a matrix of their slopes, over the root of their covariance.
    fn whitened<C: nalgebra::Dim>(
        &self,
        patch: &StackPatch,
        of_patch: nalgebra::OMatrix<f64, nalgebra::Dyn, C>,
    ) -> nalgebra::OMatrix<f64, nalgebra::Dyn, C>
    where
        nalgebra::DefaultAllocator: nalgebra::allocator::Allocator<nalgebra::Dyn, C>,
    {
        let mut covariance = self.model_error.clone();
        if self.chart.camera.is_none() {
            for (i, (value, error)) in patch.values.iter().zip(&patch.std_errors).enumerate() {
                covariance[(i, i)] += (error / value.max(DARKEST)).powi(2);
            }
        }
        let root = covariance.cholesky().map(nalgebra::Cholesky::unpack);
        root.and_then(|root| root.solve_lower_triangular(&of_patch)).unwrap_or(of_patch)
    }

    /// Covariance of residuals that were held out; of few it is drawn towards independent channels.
    pub(crate) fn errors_of(&self, held_out: &PatchValues) -> DMatrix<f64> {
        let k = self.chart.components();
        if held_out.is_empty() {
            // Colours have no errors of their own.
            let error = if self.chart.camera.is_some() { FIRST_ERROR[0] } else { LEAST_ERROR[1] };
            return DMatrix::identity(k, k) * error.powi(2);
        }
        let mut sum = DMatrix::zeros(k, k);
        for (patch, expected) in self.chart.patches.iter().zip(held_out) {
            let residual = residual(self.chart, &patch.values, expected);
            sum += &residual * residual.transpose();
        }
        let n = held_out.len() as f64;
        let least = LEAST_ERROR[usize::from(self.chart.camera.is_none())].powi(2);
        let mean = |i: usize, j: usize| {
            if i == j { (sum[(i, i)] / n).max(least) } else { sum[(i, j)] / (n + k as f64) }
        };
        DMatrix::from_fn(k, k, mean)
    }
}

impl FitPlace {
    pub fn normal(&self, problem: &Problem) -> Option<&ChartEquations> {
        self.normal.get_or_init(|| Some(problem.normal(&self.at, &self.residuals))).as_ref()
    }
}

impl Problem<'_> {
    fn normal(&self, at: &DVector<f64>, residuals: &[DVector<f64>]) -> ChartEquations {
        let (mut values, slopes) = forward::with_slopes(self.chart, &self.unknowns, &self.looks, at);
        self.add_correction(&mut values);
        let mut matrix = self.precision.clone();
        let mut gradient = &self.precision * (at - &self.mean);
        let part = |(i, patch): (usize, &StackPatch)| {
            let (places, slopes) = self.slopes(patch, &residuals[i], &values[i], &slopes[i], at);
            (places, self.whitened(patch, slopes), self.whitened(patch, residuals[i].clone()))
        };
        let parts: Vec<_> = self.chart.patches.iter().enumerate().map(part).collect();
        for (places, slopes, residual) in &parts {
            add(&mut matrix, &mut gradient, places, slopes, residual, 1.0);
        }
        ChartEquations { matrix, gradient, parts }
    }

    /// The slopes of a patch's residuals, and the places of their columns.
    fn slopes(
        &self,
        patch: &StackPatch,
        residual: &DVector<f64>,
        v: &[f64],
        slopes: &[PatchSlopes],
        at: &DVector<f64>,
    ) -> (Vec<usize>, DMatrix<f64>) {
        let difference = |v: &[f64], at: &DVector<f64>| (self.residual(patch, v, at) - residual) / STEP;
        let mut places: Vec<usize> = slopes.iter().flatten().map(|(place, _)| *place).collect();
        places.sort_unstable();
        places.dedup();
        let own = self.unknowns.observed(patch, self.chart.light);
        let first = places.len();
        places.extend(&own);
        let mut matrix = DMatrix::zeros(residual.len(), places.len());
        for (channel, slopes) in slopes.iter().enumerate() {
            let mut moved = v.to_vec();
            moved[channel] += STEP;
            let by_value = difference(&moved, at);
            for (place, slope) in slopes {
                let column = places[..first].binary_search(place).unwrap_or(0);
                matrix.column_mut(column).axpy(*slope, &by_value, 1.0);
            }
        }
        for (column, place) in own.iter().enumerate() {
            let mut moved = at.clone();
            moved[*place] += STEP;
            matrix.set_column(first + column, &difference(v, &moved));
        }
        (places, matrix)
    }
}

/// The light at a place of a photograph.
pub(crate) fn light(
    chart: &Chart,
    unknowns: &ChartUnknowns,
    at: &DVector<f64>,
    (photo, [x, y]): (usize, [f64; 2]),
) -> f64 {
    if !chart.light {
        return 1.0;
    }
    let numbers = at.rows(unknowns.light(photo), OF_LIGHT);
    let terms = [1.0, x, y, x * x - 1.0 / 3.0, x * y, y * y - 1.0 / 3.0];
    1.0 + numbers.iter().zip(terms).map(|(number, term)| number * term).sum::<f64>()
}

/// Values after sheen, matrix and light.
fn seen(v: &[f64], matrix: Option<&Matrix>, sheen: f64, light: f64) -> Vec<f64> {
    let in_camera = matrix.map(|matrix| camera::product(matrix, v).to_vec());
    in_camera.unwrap_or_else(|| v.to_vec()).iter().map(|v| light * (v + sheen)).collect()
}

/// Expected less measured: of colours as ΔE₀₀, else of logarithms.
fn residual(chart: &Chart, measured: &[f64], expected: &[f64]) -> DVector<f64> {
    if chart.camera.is_some() {
        let [measured, expected] = [measured, expected].map(|v| camera::lab([v[0], v[1], v[2]]));
        return DVector::from_iterator(3, camera::difference(measured, expected));
    }
    let ln = |v: &f64| log(v.max(DARKEST));
    DVector::from_iterator(measured.len(), expected.iter().zip(measured).map(|(e, m)| ln(e) - ln(m)))
}

/// Takes a number out of the normal equations.
pub(crate) fn hold(matrix: &mut DMatrix<f64>, i: usize) {
    matrix.row_mut(i).fill(0.0);
    matrix.column_mut(i).fill(0.0);
    matrix[(i, i)] = 1.0;
}

/// Adds `sign` times the part of a patch to the normal equations.
pub(crate) fn add(
    matrix: &mut DMatrix<f64>,
    gradient: &mut DVector<f64>,
    places: &[usize],
    slopes: &DMatrix<f64>,
    residual: &DVector<f64>,
    sign: f64,
) {
    let (own, pull) = (slopes.tr_mul(slopes), slopes.tr_mul(residual));
    for (i, p) in places.iter().enumerate() {
        gradient[*p] += sign * pull[i];
        for (j, q) in places.iter().enumerate() {
            matrix[(*p, *q)] += sign * own[(i, j)];
        }
    }
}
