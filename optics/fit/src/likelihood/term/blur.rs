//! Defines the coordinate of the camera's blur: u = √(σ² + u₀²), with σ the blur's standard deviation in mm.
//!
//! A blur that is narrower than a profile's features changes it in proportion to σ², one that is wider than a pixel
//! changes a bend in proportion to σ. In u both changes are close to linear.

use optics_model::fit::FitSettings;

/// u₀ in mm: about the width from which on a blur is wider than the pixels of photographs.
const LEAST_MM: f64 = 0.01;

/// u of a variance in mm².
pub(crate) fn coordinate(variance_mm2: f64) -> f64 {
    (variance_mm2.max(0.0) + LEAST_MM * LEAST_MM).sqrt()
}

/// The variance in mm² at u.
pub(crate) fn variance_mm2(u: f64) -> f64 {
    (u * u - LEAST_MM * LEAST_MM).max(0.0)
}

/// Derivative of the variance by u.
pub(crate) fn slope(u: f64) -> f64 {
    2.0 * u
}

/// Mean and standard deviation of u for a σ with a standard error.
pub(crate) fn prior(set_up: &FitSettings) -> (f64, f64) {
    let mean = coordinate(set_up.blur_mm * set_up.blur_mm);
    (mean, coordinate((set_up.blur_mm + set_up.blur_std_error_mm).powi(2)) - mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The coordinate and the variance are inverse functions, with the given slope.
    #[test]
    fn blur_coordinate_inverts_the_variance() {
        for blur_mm in [0.0_f64, 0.002, 0.01, 0.03, 0.4] {
            let variance = blur_mm * blur_mm;
            let u = coordinate(variance);
            assert!((variance_mm2(u) - variance).abs() < 1e-15);
            let quotient = (variance_mm2(u + 1e-6) - variance_mm2(u)) / 1e-6;
            assert!((quotient - slope(u)).abs() < 2e-6);
        }
    }

    /// One standard error of the blur is one standard error of the coordinate.
    #[test]
    fn blur_error_maps_to_one_coordinate_unit() {
        let prior = |blur_mm, blur_std_error_mm| {
            super::prior(&FitSettings { blur_mm, blur_std_error_mm, ..FitSettings::default() })
        };
        let (mean, deviation) = prior(0.025, 0.001);
        assert!((variance_mm2(mean + deviation).sqrt() - 0.026).abs() < 1e-12);
        let (mean, deviation) = prior(0.0, 0.03);
        assert!(mean == LEAST_MM && (variance_mm2(mean + deviation).sqrt() - 0.03).abs() < 1e-12);
        assert_eq!(prior(0.02, 0.0).1, 0.0);
    }
}
