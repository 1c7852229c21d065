//! Describes the quantity that distinguishes a variant of the responses from the scene.

use optics_model::Grid;
use serde::Serialize;

/// The quantity that has another value in a variant.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct VariedQuantity {
    /// For example `gel thickness`.
    pub(super) quantity: String,
    /// Difference from the scene's value, in the unit.
    pub(super) step: f64,
    /// `mm`, `°`, or empty for pure numbers.
    pub(super) unit: &'static str,
}

impl VariedQuantity {
    /// The quantity of a variant, or of the baseline; `None` without such a variant.
    pub(super) fn of(grid: &Grid, variant: Option<usize>) -> Option<Self> {
        let Some(variant) = variant else {
            return Some(Self { quantity: "baseline".to_owned(), step: 0.0, unit: "" });
        };
        let (scene, variant) = (grid.scene(), grid.responses()?.variants().get(variant)?);
        let prior = scene.priors().get(variant.prior)?;
        Some(Self { quantity: scene.name_of(prior), step: variant.step, unit: prior.kind().unit() })
    }

    /// The quantity of a record of the responses; `None` for records of the axes.
    pub(super) fn of_record(grid: &Grid, record: usize) -> Option<Self> {
        let place = grid.response_of(record / grid.albedo().len())?;
        Self::of(grid, place.variant)
    }
}
