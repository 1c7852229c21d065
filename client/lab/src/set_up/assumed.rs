//! Set-up quantities without a value from the user, for which a default is used.

use optics_model::fit::FitSettings;
use optics_model::measurement::ProfileSetup;

use super::session::Session;

/// The names of the options without a value, for one profile at least, in the order in which they are printed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Assumed {
    names: Vec<&'static str>,
    /// Whether a profile has neither a blur nor its error.
    blur_unknown: bool,
}

impl Assumed {
    pub(super) fn of(values: &Session, setups: &[ProfileSetup]) -> Self {
        let lacking = |common: bool, of: fn(&ProfileSetup) -> Option<f64>| {
            !common && setups.iter().any(|s| of(s).is_none())
        };
        let names = [
            (
                "thickness_std_error_mm",
                lacking(values.thickness_std_error_mm.is_some(), |s| s.thickness_std_error_mm),
            ),
            ("origin_std_error_mm", lacking(values.origin_std_error_mm.is_some(), |s| s.origin_std_error_mm)),
            ("blur_std_error_mm", lacking(false, |s| s.blur_std_error_mm)),
            ("gain_std_error", values.gain_std_error.is_none()),
            ("offset_std_error", values.offset_std_error.is_none()),
            ("slope_std_error", values.slope_std_error.is_none()),
        ];
        Self {
            names: names.into_iter().filter(|(_, assumed)| *assumed).map(|(name, _)| name).collect(),
            blur_unknown: setups.iter().any(|s| s.blur_mm.is_none() && s.blur_std_error_mm.is_none()),
        }
    }

    /// The options' names.
    pub fn names(&self) -> &[&'static str] {
        &self.names
    }

    /// One line for people: `assumed: thickness ± 0.005 mm, …`; none if every value was given.
    pub fn text(&self, s: &FitSettings) -> Option<String> {
        // 100 × 0.003 has a digit too many.
        let percent = |share: f64| (1e6 * share).round() / 1e4;
        let values = |name: &&str| match *name {
            "thickness_std_error_mm" => format!("thickness ± {} mm", s.thickness_std_error_mm),
            "origin_std_error_mm" => format!("origin ± {} mm", s.origin_std_error_mm),
            "blur_std_error_mm" if self.blur_unknown => {
                format!("blur unknown up to {} mm", s.blur_std_error_mm)
            }
            "blur_std_error_mm" => format!("blur ± {} mm", s.blur_std_error_mm),
            "gain_std_error" => format!("gain ± {} %", percent(s.gain_std_error)),
            "offset_std_error" => format!("zero ± {}", s.offset_std_error),
            _ => format!("slope ± {} % per 10 mm", percent(s.slope_std_error)),
        };
        let values: Vec<String> = self.names.iter().map(values).collect();
        (!values.is_empty()).then(|| format!("assumed: {}", values.join(", ")))
    }
}
