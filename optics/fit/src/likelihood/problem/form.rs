//! Expresses a measured profile as a quadratic form: its nuisances are integrated out, with columns that are taken from
//! the profile itself.

use nalgebra::{Cholesky, DMatrix, DVector};
use optics_model::fit::FitSettings;

use crate::dictionary::sum::dot;
use crate::likelihood::point::Line;
use crate::likelihood::term::blur;

/// A quadratic form over pixels, with some columns integrated out.
pub(crate) struct QuadraticForm<'a> {
    weights: &'a [f64],
    /// Weighted columns, and the covariance of their coefficients.
    columns: Vec<Line>,
    root: DMatrix<f64>,
}

impl<'a> QuadraticForm<'a> {
    /// A form whose columns have coefficients of the prior variance 1.
    pub(crate) fn new(weights: &'a [f64], columns: &[Line]) -> Option<Self> {
        let weighted: Vec<Line> =
            columns.iter().map(|c| c.iter().zip(weights).map(|(c, w)| c * w).collect()).collect();
        let n = columns.len();
        let inner =
            DMatrix::from_fn(n, n, |i, j| dot(&weighted[i], &columns[j]) + f64::from(u8::from(i == j)));
        let root = Cholesky::new(inner)?.inverse();
        Some(Self { weights, columns: weighted, root })
    }

    pub(crate) fn of(&self, a: &[f64], b: &[f64]) -> f64 {
        let direct: f64 = a.iter().zip(b).zip(self.weights).map(|((a, b), w)| a * b * w).sum();
        let along =
            |f: &[f64]| DVector::from_iterator(self.columns.len(), self.columns.iter().map(|c| dot(c, f)));
        direct - along(a).dot(&(&self.root * along(b)))
    }
}

/// The weighted least-squares fit of the measurement in the basis; none if that is singular.
pub(crate) fn smoothed(values: &[f64], weights: &[f64], directions: &[Line], mean: &[f64]) -> Option<Line> {
    let n = directions.len();
    let weighted: Vec<Line> =
        directions.iter().map(|d| d.iter().zip(weights).map(|(d, w)| d * w).collect()).collect();
    let normal = DMatrix::from_fn(n, n, |i, j| dot(&weighted[i], &directions[j]));
    let trace = normal.trace();
    let rest: Line = values.iter().zip(mean).map(|(v, m)| v - m).collect();
    let right = DVector::from_iterator(n, weighted.iter().map(|w| dot(w, &rest)));
    let c = Cholesky::new(normal + DMatrix::identity(n, n) * (1e-9 * trace))?.solve(&right);
    let mut smooth = mean.to_vec();
    for (direction, c) in directions.iter().zip(c.iter()) {
        smooth.iter_mut().zip(direction).for_each(|(s, d)| *s += c * d);
    }
    Some(smooth)
}

/// Changes of the profile by one standard deviation of each nuisance; `gain` is the standard error of its gain.
pub(crate) fn loose_columns(
    smooth: &[f64],
    sensor: optics_model::scene::Sensor,
    first: usize,
    set_up: &FitSettings,
    gain: f64,
    ratio: f64,
) -> Vec<Line> {
    let last = smooth.len() - 1;
    let pitch = sensor.pitch_mm() * ratio;
    let slope = |f: &[f64]| -> Line {
        let at = |i: usize| (f[(i + 1).min(last)] - f[i.saturating_sub(1)]) / (2.0 * pitch);
        (0..=last).map(at).collect()
    };
    let by_x = slope(smooth);
    let bend = slope(&by_x);
    let scaled = |f: &[f64], by: f64| f.iter().map(|v| v * by).collect::<Line>();
    let tilted = smooth.iter().enumerate();
    let (mean, deviation) = blur::prior(set_up);
    vec![
        scaled(smooth, gain),
        vec![set_up.offset_std_error * set_up.mu; smooth.len()],
        tilted
            .map(|(i, v)| v * set_up.slope_std_error * sensor.centre_mm(first + i) * ratio / 10.0)
            .collect(),
        scaled(&by_x, set_up.origin_std_error_mm),
        scaled(&bend, 0.5 * blur::variance_mm2(mean + deviation)),
    ]
}
