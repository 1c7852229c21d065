//! The question and the answer of a measurement of several materials.

use super::{Common, Interval, MaterialFit, MuRange, ScaleCurve, SharedErrors};
use crate::invalid::{Result, check};

/// Two-sided 95 % quantile of the normal distribution.
pub const Z: f64 = 1.959_964;

/// The results for a set of materials.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The search of Eq. 3; none if the scale factor was given, or if the likelihood was maximised, which estimates it.
    pub scale: Option<ScaleCurve>,
    /// The parameters chosen for all channels.
    pub common: Common,
    pub materials: Vec<MaterialFit>,
    /// None of the paper's objective.
    pub shared_errors: SharedErrors,
}

/// The plan for finding the scale factor and the anisotropy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasurePlan {
    /// Scale factors to search; none to take that of the options.
    pub search_mu: Option<MuRange>,
    /// Relate the anisotropies of all channels: those of a material are one, about a mean of all materials.
    pub common_g: bool,
    /// Standard deviation of ln(1 − g) of a material about that mean, 0 for one value of all materials; none to estimate it
    /// from the data.
    pub g_spread: Option<f64>,
    /// Where all channels are wavelengths, the anisotropy of a material is a curve over wavelength: this is the standard
    /// deviation of the change of ln(1 − g) over 100 nm. 0 for one value.
    pub g_change: f64,
}

impl Default for MeasurePlan {
    /// Materials of similar anisotropies, at the options' scale factor.
    fn default() -> Self {
        Self { search_mu: None, common_g: true, g_spread: None, g_change: 0.1 }
    }
}

impl MeasurePlan {
    /// Refuses differences of anisotropies out of range.
    pub fn checked(self) -> Result<Self> {
        for (field, value) in [("g_spread", self.g_spread.unwrap_or(0.0)), ("g_change", self.g_change)] {
            check(field, value, |v| (0.0..=10.0).contains(&v), "allowed are 0 to 10")?;
        }
        Ok(self)
    }

    /// The interval of μ, open where the range of the search ends first.
    pub fn mu_interval(&self, mu: f64, std_error: f64) -> Interval {
        let (low, high) = (mu - Z * std_error, mu + Z * std_error);
        let (min, max, _) = self.search_mu.as_ref().map_or((low, high, 0.0), MuRange::parts);
        Interval { low: low.max(min), high: high.min(max), open_low: low < min, open_high: high > max }
    }
}
