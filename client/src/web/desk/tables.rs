//! Converts rows of tables to messages of the page's service.

use farm_figures::estimates::EstimateRow;
use farm_figures::{ChannelBudget, ErrorBudget};
use farm_lab::capture::PrecisionRow;
use optics_model::quantities::Quantity;

use super::api;

impl From<EstimateRow> for api::EstimateRow {
    fn from(row: EstimateRow) -> Self {
        let EstimateRow { quantity, of, estimate, prior, warning } = row;
        Self { quantity, of, estimate, prior, warning: warning.unwrap_or_default() }
    }
}

impl From<ErrorBudget> for api::ErrorBudget {
    fn from(budget: ErrorBudget) -> Self {
        Self { channels: budget.channels.into_iter().map(Into::into).collect(), first: budget.first }
    }
}

impl From<ChannelBudget> for api::ChannelBudget {
    fn from(ChannelBudget { about, sigma_t, shares, .. }: ChannelBudget) -> Self {
        Self { about, sigma_t, shares }
    }
}

impl From<&Quantity> for api::SetUpQuantity {
    fn from(quantity: &Quantity) -> Self {
        Self {
            name: quantity.name.to_owned(),
            help: quantity.help.to_owned(),
            default: quantity.default,
            lowest: quantity.lowest,
            highest: quantity.highest,
        }
    }
}

impl From<PrecisionRow> for api::PrecisionRow {
    fn from(PrecisionRow { material, half_widths }: PrecisionRow) -> Self {
        let [reduced_scattering, absorption, sigma_t, g] = half_widths;
        Self { material, reduced_scattering, absorption, sigma_t, g }
    }
}
