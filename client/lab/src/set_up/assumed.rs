//! Finds set-up quantities without a value from the user, for which a default is used.

use optics_model::fit::FitSettings;
use optics_model::measurement::ProfileSetup;
use optics_model::quantities::Quantity;

use super::session::{ByChannel, Session};

/// The options without a value for at least one profile, in the order of their table.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Assumed {
    quantities: Vec<&'static Quantity>,
    /// Whether a profile has neither a blur nor the blur's error.
    blur_unknown: bool,
}

impl Assumed {
    pub(super) fn of(values: &Session, setups: &[ProfileSetup]) -> Self {
        let lacking = |quantity: &Quantity| {
            !Quantity::OF_PROFILES.contains(quantity)
                || setups.iter().any(|setup| setup.value_of(quantity).is_none())
        };
        let without = values.values().filter(|(_, given)| given.and_then(ByChannel::common).is_none());
        let labelled = without.map(|(quantity, _)| quantity).filter(|quantity| !quantity.label.is_empty());
        Self {
            quantities: labelled.filter(|quantity| lacking(quantity)).collect(),
            blur_unknown: setups.iter().any(|s| s.blur_mm.is_none() && s.blur_std_error_mm.is_none()),
        }
    }

    /// The options' names.
    pub fn names(&self) -> Vec<&'static str> {
        self.quantities.iter().map(|quantity| quantity.name).collect()
    }

    /// One line for people: `assumed: thickness ± 0.005 mm, …`; `None` if nothing was assumed.
    pub fn text(&self, settings: &FitSettings) -> Option<String> {
        let assumed = settings.set_up().filter(|(quantity, _)| self.quantities.contains(quantity));
        let text = |(quantity, value): (&Quantity, f64)| match quantity.name {
            "blur_std_error_mm" if self.blur_unknown => format!("blur unknown up to {value} mm"),
            _ => quantity.labelled(value),
        };
        let texts: Vec<String> = assumed.map(text).collect();
        (!texts.is_empty()).then(|| format!("assumed: {}", texts.join(", ")))
    }
}
