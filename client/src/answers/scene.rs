//! Formats the estimates of a scene's uncertain quantities for the terminal, and the assumption of an exact scene.

use farm_figures::estimates::{self, estimate_rows};
use optics_model::fit::{Common, MaterialFit};

use crate::output::{table, warning, wrapped};

/// A row for every estimate. `None` if the scene was taken as exact.
pub(super) fn scene_text(fits: &[MaterialFit]) -> Option<String> {
    let rows = estimate_rows(fits);
    if rows.is_empty() {
        return None;
    }
    let cells = rows.iter().map(|r| [&r.quantity, &r.of, &r.estimate, &r.prior].map(Clone::clone).to_vec());
    let mut text = table(&["set-up", "of", "estimate", "prior"], &[], cells);
    text += &format!("\n{}", wrapped(estimates::NOTE));
    for line in rows.iter().filter_map(|r| r.warning.as_deref()) {
        text += &format!("\n{}", warning(&wrapped(line)));
    }
    Some(text)
}

/// The assumption if the dictionary's scene has no standard errors.
pub(super) fn exact_scene(fits: &[MaterialFit]) -> Option<String> {
    estimate_rows(fits).is_empty().then(|| {
        "scene: taken as exact (roughness, refractive indices, gel, lamps); a dictionary of a scene with their standard \
         errors, such as `lab`, includes them in the intervals"
            .to_owned()
    })
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
