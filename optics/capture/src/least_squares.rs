//! Solves weighted and robust least-squares problems.

use nalgebra::{DMatrix, DVector};

/// Parameters with their covariance: (AᵀWA)⁻¹, without any factor from the residuals.
#[derive(Debug, Clone)]
pub(crate) struct FittedParameters {
    pub x: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

impl FittedParameters {
    pub fn std_error(&self, i: usize) -> f64 {
        self.covariance[(i, i)].max(0.0).sqrt()
    }
}

/// Normal equations of a least-squares problem, built row by row.
#[derive(Debug, Clone)]
pub(crate) struct NormalEquations {
    matrix: DMatrix<f64>,
    vector: DVector<f64>,
}

impl NormalEquations {
    pub fn new(parameters: usize) -> Self {
        Self { matrix: DMatrix::zeros(parameters, parameters), vector: DVector::zeros(parameters) }
    }

    pub fn add(&mut self, row: &[f64], value: f64, weight: f64) {
        for (i, a) in row.iter().enumerate() {
            for (j, b) in row.iter().enumerate() {
                self.matrix[(i, j)] += weight * a * b;
            }
            self.vector[i] += weight * a * value;
        }
    }

    /// None if the rows do not determine the parameters.
    pub fn solve(&self) -> Option<FittedParameters> {
        // Scaled to a unit diagonal, so that undetermined parameters are recognised whatever their units.
        let n = self.vector.len();
        let scale = DVector::from_fn(n, |i, _| self.matrix[(i, i)].sqrt());
        if scale.iter().any(|s| !s.is_finite() || *s <= 0.0) {
            return None;
        }
        let scaled = DMatrix::from_fn(n, n, |i, j| self.matrix[(i, j)] / (scale[i] * scale[j]));
        let cholesky = scaled.cholesky()?;
        let inverse = cholesky.inverse();
        if inverse.iter().any(|v| !v.is_finite()) || inverse.diagonal().max() > 1e12 {
            return None;
        }
        let covariance = DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] / (scale[i] * scale[j]));
        Some(FittedParameters { x: &covariance * &self.vector, covariance })
    }
}

/// Parameters of a linear model by Tukey's weights after some rounds, and the spread of the residuals; None if the rows
/// do not determine them.
pub(crate) fn robust_fit<const N: usize>(
    points: &[([f64; N], f64)],
    rounds: usize,
) -> Option<(FittedParameters, f64)> {
    let mut weights = vec![1.0; points.len()];
    let mut found = None;
    for _ in 0..rounds {
        let mut normal = NormalEquations::new(N);
        for ((row, value), weight) in points.iter().zip(&weights) {
            normal.add(row, *value, *weight);
        }
        let solution = normal.solve()?;
        let model = |row: &[f64; N]| row.iter().zip(solution.x.iter()).map(|(r, x)| r * x).sum::<f64>();
        let residuals: Vec<f64> = points.iter().map(|(row, value)| value - model(row)).collect();
        let sigma = spread(&residuals).max(1e-9);
        weights = residuals.iter().map(|r| tukey(r / sigma)).collect();
        found = Some((solution, sigma));
    }
    found
}

/// Tukey's biweight at a residual in standard deviations; its constant keeps 95 % of the efficiency with normal
/// errors (Huber 1981).
pub(crate) fn tukey(residual: f64) -> f64 {
    let u = residual / TUKEY;
    if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
}

const TUKEY: f64 = 4.685;

/// Variance of a Tukey estimate over that of least squares, with normal errors.
pub(crate) const TUKEY_VARIANCE: f64 = 1.0 / 0.95;

/// The median of the values, which are reordered; NaN without any.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let middle = values.len() / 2;
    let upper = *values.select_nth_unstable_by(middle, f64::total_cmp).1;
    if values.len() % 2 == 1 {
        return upper;
    }
    let lower = values[..middle].iter().copied().fold(f64::NEG_INFINITY, f64::max);
    f64::midpoint(lower, upper)
}

/// Median absolute deviation as the standard deviation of a normal distribution.
pub(crate) fn spread(values: &[f64]) -> f64 {
    let centre = median(&mut values.to_vec());
    1.4826 * median(&mut values.iter().map(|v| (v - centre).abs()).collect::<Vec<_>>())
}

/// Mean of those that are finite; 0 without any.
pub(crate) fn finite_mean(values: &[f64]) -> f64 {
    let finite = values.iter().filter(|v| v.is_finite());
    finite.clone().sum::<f64>() / finite.count().max(1) as f64
}

/// Standard error of the mean by the scatter; 0 of a single value.
pub(crate) fn scatter_of_mean(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    if values.len() < 2 { 0.0 } else { (squares / (n * (n - 1.0))).sqrt() }
}

/// Mean without outliers, and its standard error.
pub(crate) fn robust_mean(values: &[f64]) -> (f64, f64) {
    let sigma = spread(values).max(f64::MIN_POSITIVE);
    let mut centre = median(&mut values.to_vec());
    let mut weights = 0.0;
    for _ in 0..8 {
        let (mut sum, mut total) = (0.0, 0.0);
        for v in values {
            let w = tukey((v - centre) / sigma);
            sum += w * v;
            total += w;
        }
        weights = total;
        if total > 0.0 {
            centre = sum / total;
        }
    }
    (centre, sigma / weights.max(1.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The median of few values is exact, for odd and even numbers of them.
    #[test]
    fn median_of_few_values_is_exact() {
        assert_eq!(median(&mut [3.0]), 3.0);
        assert_eq!(median(&mut [3.0, 1.0]), 2.0);
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 2.5);
    }

    #[test]
    fn line_comes_back_with_its_covariance() {
        let mut normal = NormalEquations::new(2);
        for i in 0..11 {
            let t = f64::from(i) - 5.0;
            normal.add(&[1.0, t], 3.0 - 2e-3 * t, 4.0);
            assert_eq!(normal.solve().is_some(), i > 0, "one point determines no line");
        }
        let line = normal.solve().unwrap();
        assert!((line.x[0] - 3.0).abs() < 1e-12 && (line.x[1] + 2e-3).abs() < 1e-12);
        assert!((line.std_error(0) - (1.0 / 44.0_f64).sqrt()).abs() < 1e-12);
        assert!((line.std_error(1) - (1.0 / 440.0_f64).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn dust_does_not_move_a_robust_mean() {
        let mut values: Vec<f64> = (0..101).map(|i| f64::from(i) / 100.0 - 0.5).collect();
        values.extend([50.0; 10]);
        let (mean, error) = robust_mean(&values);
        assert!(mean.abs() < 0.03 && error < 0.1, "{mean} ± {error}");
    }
}
