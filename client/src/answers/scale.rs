//! The scale factor and the anisotropy that all channels share.

use farm_figures::estimates::estimate_rows;
use farm_figures::numbers::{interval, significant, with_error};
use farm_lab::document::{Block, ValueTable};
use optics_model::fit::{Common, GError, MaterialFit, ScaleCurve};

use crate::output::lines;

/// The lines of [`common_blocks`].
pub(crate) fn common_text(common: &Common) -> String {
    lines(&common_blocks(common))
}

/// Scale factor and anisotropy, and whether they were given or fitted.
pub(crate) fn common_blocks(common: &Common) -> Vec<Block> {
    let i = &common.mu_interval;
    let mut lines = Vec::new();
    if !common.mu_chosen {
        lines.push(given_text(common));
    } else if i.open_low && i.open_high {
        lines.push(format!(
            "scale factor μ: not determined by these data; taken as {} ± {} (tried: {} to {}). If the photographs are \
             calibrated, give it: --mu 1",
            significant(common.mu, 4),
            significant(common.mu_std_error, 1),
            i.low,
            i.high
        ));
    } else {
        let value = with_error(common.mu, common.mu_std_error);
        let mut line = format!("scale factor μ = {value}, chosen with all channels together");
        if i.open_low || i.open_high {
            line += "; it may lie beyond the values tried: widen them with --mu-min and --mu-max";
        }
        lines.push(line);
    }
    match (common.g, &common.g_interval) {
        (Some(g), Some(i)) if let Some(spread) = common.g_spread => {
            let p = common.g_equal_probability.map_or(String::new(), |p| {
                format!("; one g of all would differ as much with p = {}", significant(p, 2))
            });
            lines.push(format!(
                "anisotropy g = {}, the mean of the materials (95 %: {}); ln(1−g) of each about it: ± {}{p}",
                significant(g, 3),
                interval(i, |v| significant(v, 2)),
                significant(spread, 2)
            ));
        }
        (Some(g), Some(i)) => lines.push(format!(
            "anisotropy g = {}, chosen as common to all channels (95 %: {})",
            significant(g, 3),
            interval(i, |v| significant(v, 2))
        )),
        (Some(g), None) if common.by_g.len() > 1 => lines.push(format!(
            "anisotropy g = {g}, of the dictionary's that with the least error of all channels together"
        )),
        (Some(g), None) => lines.push(format!("anisotropy g = {g}: given, or the dictionary's only one")),
        (None, _) if let Some(change) = common.g_change => lines.push(format!(
            "anisotropy g: a curve over wavelength; prior of the change of ln(1−g) over 100 nm: ± {change}{}",
            common.g_spread.map_or(String::new(), |s| format!(
                "; ln(1−g) of a material about the mean: ± {}",
                significant(s, 2)
            ))
        )),
        (None, _) => lines.push("every channel has its own anisotropy".to_owned()),
    }
    lines.into_iter().map(Block::Paragraph).collect()
}

/// The paper's search for the scale factor (Eq. 3), by the errors of the best records.
pub(crate) fn scale_blocks(scale: &ScaleCurve) -> Vec<Block> {
    let error = scale.std_error.map_or(String::new(), |e| format!(" ± {}", significant(e, 1)));
    // A parabola with this curvature: e(μ) = e(μ*) (1 + ½ c (μ − μ*)²).
    let minimum = match scale.curvature {
        Some(c) if c > 0.0 => {
            format!("; 0.01 away from it the error is {:.2} % larger", 0.5 * c * 1e-4 * 100.0)
        }
        Some(_) => "; near it the error does not rise: the minimum is not sharp".to_owned(),
        None => String::new(),
    };
    let mut blocks = vec![
        Block::heading(3, "By the best records alone, as in the paper's Eq. 3"),
        Block::Paragraph(format!("μ* = {}{error} (error {:.4}{minimum})", scale.best.mu, scale.best.error)),
    ];
    if scale.at_end {
        let text = "μ* lies at an end of the values tried: widen them with --mu-min and --mu-max";
        blocks.push(Block::paragraph(text));
    }
    if scale.by_g.len() > 1 {
        let row = |e: &GError| {
            let mark = if e.g == scale.best_g { " (best)" } else { "" };
            let there = format!("{:.4}", e.best_mu_error);
            vec![format!("{}{mark}", e.g), format!("{:.4}", e.error), e.best_mu.to_string(), there]
        };
        let head = ">g common\nto all | >error\nat μ* | >its own\nbest μ | >error\nthere";
        blocks.push(ValueTable::new(head, scale.by_g.iter().map(row)).block());
    }
    blocks
}

/// A given scale factor, updated by the data if it has a standard error.
fn given_text(common: &Common) -> String {
    if common.mu_std_error == 0.0 {
        return format!("scale factor μ = {}, as given", common.mu);
    }
    let value = with_error(common.mu, common.mu_std_error);
    format!("scale factor μ = {value}, from what was given and the data")
}

/// The warning about a scale factor so low that the dictionary's surfaces are the most likely cause. `None` if its scene
/// is uncertain: such scenes conserve light, and their estimates contain the remaining causes.
pub(crate) fn low_scale(common: &Common, fits: &[MaterialFit]) -> Option<String> {
    /// Scale factors below this are hardly explained by a white reference or by exposure.
    const LOW: f64 = 0.95;
    let low =
        common.mu_chosen && common.mu + 2.0 * common.mu_std_error < LOW && estimate_rows(fits).is_empty();
    let warning = "the scale factor is low: if the dictionary's scene is one whose rough surfaces lose light, such as \
                   `paper`, that light is the most likely cause, and σ_t and α are wrong; measure with the dictionary \
                   lab, whose surfaces lose none";
    low.then(|| warning.to_owned())
}
