//! The settings of an answer as JSON.

use optics_model::fit::{Bounds, FitOptions, FitSettings, Objective, PhaseModel, Wavelet};
use serde::{Serialize, Serializer};

use farm_lab::measurement_file::Note;
use farm_lab::set_up::Assumed;

/// The quantities of the set-up by their names.
#[derive(Debug)]
pub(crate) struct SetUpJson<'a>(pub &'a FitSettings);

impl Serialize for SetUpJson<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.set_up().map(|(quantity, value)| (quantity.name, value)))
    }
}

/// Settings used for a fit.
#[derive(Debug, Serialize)]
pub(crate) struct UsedOptions<'a> {
    dictionary: &'a str,
    lambda: f64,
    mu: f64,
    mu_std_error: f64,
    /// Null if free or a range.
    g: Option<f64>,
    g_range: Bounds,
    sigma_t_range: Bounds,
    albedo_range: Bounds,
    wavelet: Wavelet,
    level: u32,
    /// Null for the likelihood.
    objective: Option<Objective>,
    phase: PhaseModel,
    #[serde(flatten)]
    set_up: SetUpJson<'a>,
    /// The quantities of the set-up without a value for at least one profile.
    assumed: Vec<&'static str>,
}

/// An answer about a measurement file as JSON.
#[derive(Debug, Serialize)]
pub(crate) struct MeasurementAnswer<'a, T> {
    #[serde(flatten)]
    pub(crate) options: UsedOptions<'a>,
    #[serde(flatten)]
    pub(crate) answer: T,
    /// Assumptions made in reading the file, and suspicious data in it.
    pub(crate) notes: &'a [Note],
}

impl<'a> UsedOptions<'a> {
    pub(crate) fn new(dictionary: &'a str, options: &'a FitOptions, assumed: &Assumed) -> Self {
        let s = options.settings();
        Self {
            dictionary,
            lambda: s.lambda,
            mu: s.mu,
            mu_std_error: s.mu_std_error,
            g: s.g.is_fixed().then_some(s.g.min()),
            g_range: s.g,
            sigma_t_range: s.sigma_t_per_mm,
            albedo_range: s.albedo,
            wavelet: s.wavelet,
            level: s.level,
            objective: s.objective,
            phase: s.phase,
            set_up: SetUpJson(s),
            assumed: assumed.names(),
        }
    }
}
