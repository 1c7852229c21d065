//! Formats estimates of a scene's uncertain quantities as rows of text, for the terminal's table, the report and the
//! page. Rows are marked where the data contradict a prior or an estimate lies at an end of the responses.

use std::collections::BTreeMap;

use optics_model::fit::{MaterialFit, SceneEstimate};
use optics_model::scene::Scope;
use serde::Serialize;

use crate::numbers::{minus, significant, with_error};

/// Limits of the standard errors in the rows.
pub const NOTE: &str = "the noise of the dictionary's responses makes errors of what a session shares too small, by a \
                        factor of up to 1.2 in tests, and 1.5 with three anisotropies only";

/// Estimate and prior of one quantity, and the profiles that share it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct EstimateRow {
    /// For example `gel thickness`.
    pub quantity: String,
    /// The profiles that share the quantity: `all` for the session, a material, or a slab as in `white 0.5 mm`.
    pub of: String,
    /// With its standard error and unit, for example `0.024 ± 0.002 mm`.
    pub estimate: String,
    pub prior: String,
    /// The reason why the estimate is doubtful, if it is.
    pub warning: Option<String>,
}

/// One row for each quantity and each set of profiles that shares it; empty if the scene was taken as exact.
///
/// Channels of a set share estimates; where they differ by the data of each channel, the best determined one is shown.
pub fn estimate_rows(fits: &[MaterialFit]) -> Vec<EstimateRow> {
    let mut all: BTreeMap<(&str, String), &SceneEstimate> = BTreeMap::new();
    for fit in fits {
        let refined = fit.channels.iter().filter_map(|c| Some((c.channel.as_str(), c.refined.as_ref()?)));
        for (channel, estimate) in refined.flat_map(|(c, r)| r.likelihood.scene.iter().map(move |e| (c, e))) {
            let sharers = shared_by(estimate, &fit.material, channel);
            let known = all.entry((estimate.quantity.as_str(), sharers)).or_insert(estimate);
            if estimate.std_error < known.std_error {
                *known = estimate;
            }
        }
    }
    all.into_iter().map(|((_, of), estimate)| row(of, estimate)).collect()
}

fn shared_by(estimate: &SceneEstimate, material: &str, channel: &str) -> String {
    match (estimate.scope, estimate.slab_mm) {
        (Scope::Session, _) => "all".to_owned(),
        (Scope::Channel, _) => format!("{material} {channel}"),
        (_, None) => material.to_owned(),
        (_, Some(mm)) => format!("{material} {mm} mm"),
    }
}

fn row(of: String, e: &SceneEstimate) -> EstimateRow {
    EstimateRow {
        warning: warning(&of, e),
        quantity: e.quantity.clone(),
        of,
        estimate: with_unit(&with_error(e.value, e.std_error), e),
        prior: prior(e),
    }
}

fn warning(of: &str, e: &SceneEstimate) -> Option<String> {
    let quantity = &e.quantity;
    let with_error = with_error(e.value, e.std_error);
    // As many digits as the standard error justifies.
    let found = with_unit(with_error.split(' ').next().unwrap_or_default(), e);
    if e.at_end {
        return Some(format!(
            "{quantity} ({of}): the estimate {found} lies where the dictionary's responses end; compute a dictionary whose \
             scene has its value, measured or as estimated"
        ));
    }
    let off = ((e.value - e.prior) / e.prior_std_error).abs();
    let prior = prior(e);
    e.is_conflict().then(|| {
        format!(
            "{quantity} ({of}): the estimate {found} is {off:.1} standard deviations from its prior {prior}: the scene does \
             not describe this set-up, or something else is wrong with the data"
        )
    })
}

/// A prior as it was given, with two digits of a computed error.
fn prior(e: &SceneEstimate) -> String {
    with_unit(&format!("{} ± {}", significant(e.prior, 4), significant(e.prior_std_error, 2)), e)
}

fn with_unit(numbers: &str, e: &SceneEstimate) -> String {
    let numbers = minus(numbers);
    if e.unit.is_empty() { numbers } else { format!("{numbers} {}", e.unit) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{channel, scene_estimates};

    /// Channels share a row, in which the best determined estimate is shown.
    #[test]
    fn channels_share_a_row() {
        let mut channels = vec![channel("R", 6.0, 1.0), channel("G", 9.0, 1.0)];
        let white_rows = |channels| estimate_rows(&[MaterialFit { material: "white".into(), channels }]);
        assert_eq!(white_rows(channels.clone()), [], "the scene is exact");
        channels[0].refined.as_mut().unwrap().likelihood.scene = scene_estimates();
        let better = channels[1].refined.as_mut().unwrap();
        better.likelihood.scene = scene_estimates();
        better.likelihood.scene[0].std_error = 0.0008;
        let rows = white_rows(channels);
        let cells: Vec<_> = rows.iter().map(|r| [&r.quantity, &r.of, &r.estimate, &r.prior]).collect();
        assert_eq!(
            cells,
            [
                ["gel thickness", "white 0.5 mm", "0.0972 ± 0.0008 mm", "0.02 ± 0.02 mm"],
                ["ring angle", "all", "45.2 ± 0.9 °", "45 ± 1 °"],
                ["sample roughness", "white", "0.120 ± 0.004", "0.05 ± 0.03"],
            ]
        );
        let warnings: Vec<&str> = rows.iter().map(|r| r.warning.as_deref().unwrap_or_default()).collect();
        assert!(warnings[0].contains("0.0972 mm is 3.9 standard deviations from its prior 0.02 ± 0.02 mm"));
        assert!(
            warnings[1].is_empty() && warnings[2].contains("0.120 lies where the dictionary's responses end")
        );
    }
}
