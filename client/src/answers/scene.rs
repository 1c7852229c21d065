//! The uncertain quantities of the scene as people read them: estimates with their priors, and warnings where the data
//! contradict a prior or lead beyond the responses.

use std::collections::BTreeMap;

use farm_figures::numbers::{minus, with_error};
use optics_model::fit::{Common, MaterialFit, SceneEstimate};
use optics_model::scene::Scope;

use crate::output::{table, warning, wrapped};

/// Estimates of one quantity for what shares it, the session, a material or a slab, each once.
type Estimates<'a> = BTreeMap<(&'a str, String), &'a SceneEstimate>;

/// A row for every estimate. None if the scene was taken as exact.
pub(super) fn scene_text(fits: &[MaterialFit]) -> Option<String> {
    let estimates = estimates(fits);
    if estimates.is_empty() {
        return None;
    }
    let rows = estimates.iter().map(|((quantity, of), e)| {
        let numbers = with_unit(&with_error(e.value, e.std_error), e);
        vec![(*quantity).to_owned(), of.clone(), numbers, prior(e)]
    });
    let mut text = table(&["set-up", "of", "estimate", "prior"], &[], rows);
    let note = "the errors of these estimates leave out the noise of the dictionary's responses: roughnesses and indices \
                are less certain";
    text += &format!("\n{}", wrapped(note));
    for line in warnings(&estimates) {
        text += &format!("\n{}", warning(&wrapped(&line)));
    }
    Some(text)
}

/// What is assumed where the dictionary's scene has no standard errors.
pub(super) fn exact_scene(fits: &[MaterialFit]) -> Option<String> {
    estimates(fits).is_empty().then(|| {
        "scene: taken as exact (roughness, refractive indices, gel, lamps); a dictionary of a scene with their standard \
         errors, such as `lab`, includes them in the intervals"
            .to_owned()
    })
}

/// The warning about a scale factor so low that the dictionary's surfaces are the likeliest cause. None if its scene is
/// uncertain: such scenes conserve light, and have the remaining causes in their estimates.
pub(crate) fn low_scale(common: &Common, fits: &[MaterialFit]) -> Option<String> {
    /// Scale factors that a white reference, or exposure, hardly explains.
    const LOW: f64 = 0.95;
    let low = common.mu_chosen && common.mu + 2.0 * common.mu_std_error < LOW && estimates(fits).is_empty();
    let warning = "the scale factor is low: if the dictionary's scene is one whose rough surfaces lose light, such as \
                   `paper`, that light is the likeliest cause, and σ_t and α are wrong; measure with `--dictionary lab`, \
                   whose surfaces lose none";
    low.then(|| warning.to_owned())
}

/// Channels of a set share estimates; where they differ by what each channel adds, the best determined one is shown.
fn estimates(fits: &[MaterialFit]) -> Estimates<'_> {
    let mut all = Estimates::new();
    for fit in fits {
        let refined = fit.channels.iter().filter_map(|c| c.refined.as_ref());
        for estimate in refined.flat_map(|r| &r.likelihood.scene) {
            let of = match (estimate.scope, estimate.slab_mm) {
                (Scope::Session, _) => "all".to_owned(),
                (_, None) => fit.material.clone(),
                (_, Some(mm)) => format!("{} {mm} mm", fit.material),
            };
            let known = all.entry((estimate.quantity.as_str(), of)).or_insert(estimate);
            if estimate.std_error < known.std_error {
                *known = estimate;
            }
        }
    }
    all
}

fn warnings(estimates: &Estimates) -> Vec<String> {
    let line = |((quantity, of), e): (&(&str, String), &&SceneEstimate)| {
        let off = ((e.value - e.prior) / e.prior_std_error).abs();
        let found = with_unit(&minus(&significant(e)), e);
        if e.at_end {
            Some(format!(
                "{quantity} ({of}): the estimate {found} lies where the dictionary's responses end; measure it, and \
                 compute a dictionary whose scene has the measured value"
            ))
        } else if e.is_conflict() {
            Some(format!(
                "{quantity} ({of}): the estimate {found} is {off:.1} standard deviations from its prior {}: the scene \
                 does not describe this set-up, or something else is wrong with the data",
                prior(e)
            ))
        } else {
            None
        }
    };
    estimates.iter().filter_map(line).collect()
}

/// As many digits as the error has meaning for.
fn significant(e: &SceneEstimate) -> String {
    with_error(e.value, e.std_error).split(' ').next().unwrap_or_default().to_owned()
}

fn prior(e: &SceneEstimate) -> String {
    with_unit(&format!("{} ± {}", e.prior, e.prior_std_error), e)
}

fn with_unit(numbers: &str, e: &SceneEstimate) -> String {
    if e.unit.is_empty() { numbers.to_owned() } else { format!("{numbers} {}", e.unit) }
}
