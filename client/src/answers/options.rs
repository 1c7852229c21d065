//! The settings that an answer came by, as programs read them.

use optics_model::fit::{Bounds, FitOptions, Wavelet};
use serde::Serialize;

/// Settings of Eqs. 1 and 2, as they were used.
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
}

impl<'a> UsedOptions<'a> {
    pub(crate) fn new(dictionary: &'a str, options: &FitOptions) -> Self {
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
        }
    }
}
