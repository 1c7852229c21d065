//! The question and the answer of a measurement of several materials, which both objectives share.

use optics_model::fit::{Common, Interval, MaterialFit, MuRange, ScaleCurve};

use crate::paper::intervals::Z;

/// What was found for a set of materials.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The paper's search of the scale factor, by the errors of records; none if it was given, or if the likelihood was
    /// maximised, which estimates it itself.
    pub scale: Option<ScaleCurve>,
    /// What was chosen for all channels, by refined errors.
    pub common: Common,
    pub materials: Vec<MaterialFit>,
}

/// How the scale factor and the anisotropy are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasurePlan {
    /// Scale factors to search; none to take that of the options.
    pub search_mu: Option<MuRange>,
    /// Hold all materials at the anisotropy that explains them best together.
    pub common_g: bool,
}

/// Where μ lies; open where the range of the search ends first.
pub(super) fn mu_interval(mu: f64, std_error: f64, range: Option<&MuRange>) -> Interval {
    let (low, high) = (mu - Z * std_error, mu + Z * std_error);
    let (min, max, _) = range.map_or((low, high, 0.0), MuRange::parts);
    Interval { low: low.max(min), high: high.min(max), open_low: low < min, open_high: high > max }
}
