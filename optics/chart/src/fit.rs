//! The fit of a chart: damped steps over few directions, corrected by the values over all of them, with the covariance of
//! the residuals that cross-validation leaves.

use nalgebra::{DMatrix, DVector};
use optics_model::descent::{Descent, DescentEnd};

use crate::Chart;
use crate::folds;
use crate::forward::{PatchValues, looks};
use crate::problem::{ChartEquations, FIRST_ERROR, Problem, hold, light};
use crate::unknowns::ChartUnknowns;

/// Descents with new weights; the last two are about the values over all directions.
const ROUNDS: usize = 3;
/// Descents whose weights are not the last ones end earlier.
const DESCENTS: [Descent; ROUNDS] = [
    Descent { most_steps: 60, tolerance: 0.1 },
    Descent { most_steps: 60, tolerance: 0.1 },
    Descent { most_steps: 100, tolerance: 0.01 },
];

/// The answer about a chart.
#[derive(Debug, Clone)]
pub struct ChartFit {
    pub unknowns: ChartUnknowns,
    /// All numbers, and their covariance.
    pub at: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// Expected values of the patches.
    pub fitted: PatchValues,
    /// Expected values from the other patches, without those of the patch's own fold.
    pub held_out: PatchValues,
    /// Covariance of the residuals of patches that were held out: of (ΔL, ΔC, ΔH) over their weights, or of ln values.
    pub model_error: DMatrix<f64>,
    /// Sum of the squares of the residuals over their errors.
    pub chi2: f64,
    pub end: DescentEnd,
}

/// The media of a chart. None if the prior of the media is not positive definite.
pub fn fit(chart: &Chart) -> Option<ChartFit> {
    let unknowns = ChartUnknowns::new(chart);
    let (mean, precision) = unknowns.prior(chart)?;
    let all: Vec<usize> = (0..chart.patches.len()).collect();
    let first = FIRST_ERROR[usize::from(chart.camera.is_none())].powi(2);
    let mut problem = Problem {
        chart,
        looks: looks(chart, &all, true),
        mean,
        precision,
        correction: Vec::new(),
        model_error: DMatrix::identity(chart.components(), chart.components()) * first,
        unknowns,
    };
    let fine = looks(chart, &all, false);
    let mut at = problem.best_start()?;
    let mut end = DescentEnd::OutOfSteps;
    for (round, descent) in DESCENTS.into_iter().enumerate() {
        let place = problem.descended(at, descent);
        (at, end) = (place.at.at.clone(), place.end);
        if round + 1 == ROUNDS {
            break;
        }
        problem.correct(&fine, &at);
        let place = problem.place(at.clone());
        let held_out = folds::held_out(&problem, &place.at, place.normal(&problem)?)?;
        problem.model_error = problem.errors_of(&held_out);
    }
    let place = problem.place(at);
    let normal = place.normal(&problem)?;
    let covariance = covariance(&problem.unknowns, normal)?;
    let patches = chart.patches.iter().zip(&place.values);
    let fitted = patches.map(|(patch, v)| problem.observed(patch, v, &place.at)).collect();
    let held_out = folds::held_out(&problem, &place.at, normal)?;
    let model_error = problem.errors_of(&held_out);
    let prior = &place.at - &problem.mean;
    Some(ChartFit {
        at: place.at.clone(),
        covariance,
        fitted,
        held_out,
        model_error,
        chi2: place.cost - prior.dot(&(&problem.precision * &prior)),
        end,
        unknowns: problem.unknowns,
    })
}

impl ChartFit {
    /// The light at a place of a photograph, in that of an even one.
    pub fn light(&self, chart: &Chart, place: (usize, [f64; 2])) -> f64 {
        light(chart, &self.unknowns, &self.at, place)
    }
}

/// The covariance of all numbers. The index is not estimated, for errors of the model would move it; the others have moved
/// with its error.
fn covariance(unknowns: &ChartUnknowns, normal: &ChartEquations) -> Option<DMatrix<f64>> {
    let mut matrix = normal.matrix.clone();
    hold(&mut matrix, unknowns.ior);
    let inverse = matrix.cholesky()?.inverse();
    let mut by_index = -(&inverse * normal.matrix.column(unknowns.ior));
    by_index[unknowns.ior] = 1.0;
    let mut covariance = inverse;
    covariance[(unknowns.ior, unknowns.ior)] = 0.0;
    Some(covariance + &by_index * by_index.transpose())
}
