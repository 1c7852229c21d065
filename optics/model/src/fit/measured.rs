//! The question and the answer of a measurement of several materials.

use super::{Common, Interval, MaterialFit, MuRange, ScaleCurve, SharedErrors};
use crate::invalid::{Invalid, Result};

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
    /// Hold all materials at the anisotropy that explains them best together.
    pub common_g: bool,
    /// Where all channels are wavelengths, a common anisotropy is a curve over wavelength: this is the standard
    /// deviation of the change of ln(1 − g) over 100 nm. 0 for one value.
    pub g_change: f64,
}

impl Default for MeasurePlan {
    /// A common anisotropy, at the options' scale factor.
    fn default() -> Self {
        Self { search_mu: None, common_g: true, g_change: 0.1 }
    }
}

impl MeasurePlan {
    /// Refuses changes of the anisotropy out of range.
    pub fn checked(self) -> Result<Self> {
        if (0.0..=10.0).contains(&self.g_change) {
            Ok(self)
        } else {
            Err(Invalid::new("g_change", self.g_change, "allowed are 0 to 10"))
        }
    }

    /// The interval of μ, open where the range of the search ends first.
    pub fn mu_interval(&self, mu: f64, std_error: f64) -> Interval {
        let (low, high) = (mu - Z * std_error, mu + Z * std_error);
        let (min, max, _) = self.search_mu.as_ref().map_or((low, high, 0.0), MuRange::parts);
        Interval { low: low.max(min), high: high.min(max), open_low: low < min, open_high: high > max }
    }
}
