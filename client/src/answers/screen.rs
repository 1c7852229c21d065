//! The first screen of a measurement: the verdict, one table of the media, what is in doubt, and what to improve. `-v` shows
//! the whole answer instead.

use farm_figures::error_budget;
use farm_figures::numbers::{interval, significant, to_error};
use farm_lab::document::{Block, Remark, ValueTable};
use optics_model::fit::{Common, MaterialFit, Refined};

use super::fits::rows;
use super::scale::common_blocks;
use super::summary::{Estimated, quantities};
use super::{all_remarks, verdict};

/// Most warnings that are shown.
const WARNINGS: usize = 4;

/// A half-width of an interval about its value, as a share of the value, up to which both are printed as `3.58 ± 0.11`, and
/// the most that its middle deviates from the value, in half-widths.
const NARROW: f64 = 0.5;
const ASIDE: f64 = 0.25;

/// The first screen.
pub(crate) fn screen_blocks(common: &Common, fits: &[MaterialFit]) -> Vec<Block> {
    let mut blocks = vec![Block::Verdict(verdict(fits).sentences.join(" "))];
    // A scale factor that was searched is an answer of its own.
    blocks.extend(common_blocks(common).into_iter().next().filter(|_| common.mu_chosen));
    let cells = |r: &Refined| {
        let [reduced_scattering, absorption, sigma_t, _, g] = quantities(r);
        let ratio = r.likelihood.chi2 / r.likelihood.degrees_of_freedom;
        let numbers = [(reduced_scattering, 3), (absorption, 2), (sigma_t, 3), (g, 2)];
        let numbers = numbers.into_iter().map(|(number, digits)| cell(number, digits));
        numbers.chain([significant(ratio, 2)]).collect()
    };
    let head = "material | ch | >σ_s(1−g)\n/mm | >σ_a\n/mm | >σ_t\n/mm | >g\n | >χ² per\npixel";
    let all = rows(fits, |c| c.refined.as_ref().map_or_else(|| vec!["–".to_owned(); 5], cells));
    blocks.push(ValueTable::new(head, all).cards().block());
    let warnings: Vec<Remark> = all_remarks(fits).into_iter().filter(|remark| remark.warning).collect();
    let left = warnings.len().saturating_sub(WARNINGS);
    blocks.push(Block::Remarks(warnings.into_iter().take(WARNINGS).collect()));
    if left > 0 {
        let plural = if left > 1 { "s" } else { "" };
        blocks.push(Block::paragraph(format!("and {left} more warning{plural}: -v")));
    }
    blocks
        .extend(error_budget(fits).map(|budget| Block::paragraph(format!("To improve: {}.", budget.first))));
    blocks
}

/// `3.58 ± 0.11`, or the interval where it is open, wide, or not about its value.
fn cell((value, ends): Estimated, digits: i32) -> String {
    let half = 0.5 * (ends.high - ends.low);
    let is_open = ends.open_low || ends.open_high;
    let aside = (0.5 * (ends.high + ends.low) - value).abs();
    match half > 0.0 {
        false if !is_open => significant(value, digits),
        true if !is_open && half < NARROW * value.abs() && aside < ASIDE * half => {
            // Two digits of errors that begin with 1 to 4, as ends of intervals have.
            let leading = half / libm::pow(10.0, libm::log10(half).floor());
            to_error(value, half, if leading < 5.0 { 2 } else { 1 }).join(" ± ")
        }
        _ => interval(&ends, |end| significant(end, digits)),
    }
}

#[cfg(test)]
mod tests {
    use optics_model::fit::Interval;

    use super::*;

    /// A cell has a value with its half-width, or an interval, with the digits of its error.
    #[test]
    fn cells_have_the_digits_of_their_errors() {
        let closed = |low, high| Interval { low, high, open_low: false, open_high: false };
        let from = |low| Interval { low, high: f64::INFINITY, open_low: false, open_high: true };
        for (value, ends, expected) in [
            (3.584, closed(3.48, 3.69), "3.58 ± 0.10"),
            (0.0048, closed(0.0019, 0.0078), "0.0019…0.0078"),
            (7.6, closed(5.0, 16.0), "5…16"),
            (6.2, closed(6.0, 6.9), "6.00…6.90"),
            (0.005_36, closed(0.0047, 0.0061), "0.0054 ± 0.0007"),
            (0.4, closed(0.4, 0.4), "0.4"),
            (0.53, from(0.312), "≥ 0.31"),
        ] {
            assert_eq!(cell((value, ends), 2), expected);
        }
    }
}
