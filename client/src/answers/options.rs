//! The settings that an answer came by, as programs read them.

use optics_model::fit::{Bounds, FitOptions, Objective, Wavelet};
use serde::Serialize;

use farm_lab::set_up::Assumed;

/// Settings of a fit, as they were used.
#[derive(Debug, Serialize)]
pub(crate) struct UsedOptions<'a> {
    dictionary: &'a str,
    lambda: f64,
    mu: f64,
    mu_std_error: f64,
    gain_std_error: f64,
    offset_std_error: f64,
    /// Null if free or a range.
    g: Option<f64>,
    g_range: Bounds,
    sigma_t_range: Bounds,
    albedo_range: Bounds,
    wavelet: Wavelet,
    level: u32,
    /// Null if it is chosen by whether every profile has standard errors.
    objective: Option<Objective>,
    thickness_std_error_mm: f64,
    origin_std_error_mm: f64,
    blur_mm: f64,
    blur_std_error_mm: f64,
    slope_std_error: f64,
    /// The options among these for which a default was used, for one profile at least.
    assumed: &'a [&'static str],
}

impl<'a> UsedOptions<'a> {
    pub(crate) fn new(dictionary: &'a str, options: &FitOptions, assumed: &'a Assumed) -> Self {
        let s = options.settings();
        Self {
            dictionary,
            lambda: s.lambda,
            mu: s.mu,
            mu_std_error: s.mu_std_error,
            gain_std_error: s.gain_std_error,
            offset_std_error: s.offset_std_error,
            g: s.g.is_fixed().then_some(s.g.min()),
            g_range: s.g,
            sigma_t_range: s.sigma_t_per_mm,
            albedo_range: s.albedo,
            wavelet: s.wavelet,
            level: s.level,
            objective: s.objective,
            thickness_std_error_mm: s.thickness_std_error_mm,
            origin_std_error_mm: s.origin_std_error_mm,
            blur_mm: s.blur_mm,
            blur_std_error_mm: s.blur_std_error_mm,
            slope_std_error: s.slope_std_error,
            assumed: assumed.names(),
        }
    }
}
