//! Lists remarks that restrict the use of a fit's numbers.

use farm_figures::numbers::significant;
use optics_model::fit::{ChannelFit, Interval, Outside, Refined};

use super::likelihood::{findings, too_quiet};
use super::misfit::misfit;

/// All remarks on a channel's numbers, the warnings first.
pub(super) fn remarks(channel: &ChannelFit) -> Vec<String> {
    let valley = channel.refined.as_ref().is_some_and(|r| r.valley);
    let findings = channel.refined.as_ref().map(findings).unwrap_or_default();
    let advice = valley.then(|| "σ_t and g trade off: trust σ_s(1−g) and σ_a".to_owned());
    let g_is_open = channel.refined.as_ref().is_some_and(Refined::g_is_open);
    let open = g_is_open.then(|| "g open: σ_t and α are valid for this g only".to_owned());
    warnings(channel).into_iter().chain(findings).chain(open).chain(advice).collect()
}

/// Reasons why the numbers may be wrong.
pub(super) fn warnings(channel: &ChannelFit) -> Vec<String> {
    let mut warnings = Vec::new();
    if let Some(r) = &channel.refined {
        warnings.extend(misfit(r));
        warnings.extend(too_quiet(r));
        if !r.descent.is_minimum() {
            warnings.push("not converged: neither the medium nor its intervals hold".to_owned());
        } else if !r.resolved_at_g && channel.outside.is_none() {
            warnings.push(unresolved(&r.sigma_t_per_mm));
        }
    }
    if let Some(outside) = channel.outside {
        let (how, what) = match outside {
            Outside::Brighter => ("brighter", "white reference, scale factor"),
            Outside::Darker => ("darker", "black level, scale factor"),
        };
        warnings.push(format!(
            "outside the dictionary: {how} than every record; check {what}, or compute a wider dictionary"
        ));
    }
    warnings
}

/// The reason why a channel is unresolved: the data, or the end of the dictionary.
fn unresolved(sigma_t: &Interval) -> String {
    let narrow = sigma_t.high <= 2.0 * sigma_t.low && (sigma_t.open_low != sigma_t.open_high);
    if !narrow {
        return "unresolved: the data do not determine the medium".to_owned();
    }
    let (side, end) = if sigma_t.open_high { ("above", sigma_t.high) } else { ("below", sigma_t.low) };
    format!(
        "unresolved: σ_t may lie {side} {} /mm, where the dictionary or --sigma-t ends; compute a wider dictionary, or \
         give g",
        significant(end, 3)
    )
}
