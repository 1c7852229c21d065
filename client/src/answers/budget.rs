//! Formats the error budget of the printed intervals of σ_t as lines of text.

use farm_figures::error_budget;
use optics_model::fit::MaterialFit;

use crate::output::wrapped;

/// A line for each channel with a budget, and the source to improve first. `None` if no channel has a budget.
pub(crate) fn budget_text(fits: &[MaterialFit]) -> Option<String> {
    let budget = error_budget(fits)?;
    let mut text = "error budget of σ_t (95 %): shares of the variance, 100 % in all".to_owned();
    for channel in &budget.channels {
        text +=
            &format!("\n{}", wrapped(&format!("{}: {}: {}", channel.about, channel.sigma_t, channel.shares)));
    }
    Some(text + &format!("\n{}", wrapped(&format!("to improve first: {}", budget.first))))
}
