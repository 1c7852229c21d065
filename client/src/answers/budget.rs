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

#[cfg(test)]
mod tests {
    use farm_figures::testing::channel;

    use super::*;

    /// The largest source and its remedy are the last line.
    #[test]
    fn budget_ends_with_what_to_improve() {
        assert_eq!(budget_text(&[]), None);
        let channels = vec![channel("G", 6.0, 1.0)];
        let text = budget_text(&[MaterialFit { material: "white".into(), channels }]).unwrap();
        assert!(text.contains("\nwhite G: 5.4…6.6 / mm: g 80 %, thickness 12 %, noise 8 %\n"), "{text}");
        assert!(text.contains("\nto improve first: g, 80 % of the variance of σ_t on average"), "{text}");
    }
}
