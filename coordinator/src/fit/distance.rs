//! The distance between a measured and a simulated profile, Eq. 2.

use std::ops::Range;

use super::gradient::{LEVEL, Wavelet, derivative};

/// Pixel pitch that gradients are told per, in mm: 360 pixels over 10 mm.
const REFERENCE_PITCH_MM: f64 = 10.0 / 360.0;

/// |∇f| per sample of the reference pitch, for a profile with pixels of `pitch_mm`.
pub(super) fn gradient_magnitude(f: &[f64], pitch_mm: f64) -> Vec<f64> {
    let scale = REFERENCE_PITCH_MM / pitch_mm;
    derivative(f, Wavelet::QuadraticSpline, LEVEL).into_iter().map(|d| d.abs() * scale).collect()
}

/// Root mean square of a_i − b_i, summed in double precision.
pub(super) fn rms_difference(a: &[f64], b: &[f32]) -> f64 {
    debug_assert_eq!(a.len(), b.len());
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (a - f64::from(*b)).powi(2)).sum();
    (sum / a.len() as f64).sqrt()
}

/// A measured profile made ready for comparison: μ F_A and |∇ μ F_A| on the pixels that it covers.
#[derive(Debug)]
pub(super) struct Target {
    pub pixels: Range<usize>,
    pub values: Vec<f64>,
    pub gradient: Vec<f64>,
}

impl Target {
    pub(super) fn new(pixels: Range<usize>, values: Vec<f64>, mu: f64, pitch_mm: f64) -> Self {
        let values: Vec<f64> = values.into_iter().map(|v| mu * v).collect();
        let gradient = gradient_magnitude(&values, pitch_mm);
        Self { pixels, values, gradient }
    }

    /// The two norms of Eq. 2: of the values' difference and of the gradients'.
    pub(super) fn norms(&self, values: &[f32], gradient: &[f32]) -> (f64, f64) {
        (rms_difference(&self.values, values), rms_difference(&self.gradient, gradient))
    }
}
