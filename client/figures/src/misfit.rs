//! States in a few words how well a fit explains its measurement.

use optics_model::fit::{Cause, Likelihood, Refined};

use crate::numbers::significant;

/// Probability of χ² below which noise and the uncertainty of the set-up do not explain a measurement.
const UNLIKELY: f64 = 1e-3;

/// Whether χ² is too large to be caused by noise and the uncertainty of the set-up.
pub fn is_unlikely(l: &Likelihood) -> bool {
    l.probability < UNLIKELY
}

/// `χ² 712 of 716, p = 0.53`.
pub fn goodness(l: &Likelihood) -> String {
    let p = if is_unlikely(l) {
        format!("p < {UNLIKELY}")
    } else {
        format!("p = {}", significant(l.probability, 2))
    };
    format!("χ² {:.0} of {:.0}, {p}", l.chi2, l.degrees_of_freedom)
}

/// Goodness of fit and most likely cause in few words, for figures; `None` if noise explains the fit.
pub fn misfit_short(refined: &Refined) -> Option<String> {
    let likelihood = &refined.likelihood;
    let (goodness, s) = match &refined.suspicion {
        None if is_unlikely(likelihood) => return Some(format!("{}: not explained", goodness(likelihood))),
        Some(s) if is_unlikely(likelihood) => (goodness(likelihood), s),
        // The media absorb the error, so that χ² does not show it.
        Some(s) => ("not to be trusted".to_owned(), s),
        None => return None,
    };
    let amount = |unit: &str| format!("{} {unit}", significant(s.amount, 2));
    let percent = format!("{} %", significant(100.0 * s.amount, 2));
    let short = match s.cause {
        Cause::Unknown => return Some(format!("{goodness}: not explained")),
        Cause::EdgeOffset => format!("edge {} off?", amount("mm")),
        Cause::Gain => format!("values {percent} off?"),
        Cause::Zero => format!("zero {} off?", significant(s.amount, 2)),
        Cause::Slope => format!("slope {percent}?"),
        Cause::Wedge => format!("wedge {percent}?"),
        Cause::Blur => format!("blur {}?", amount("mm")),
        Cause::GammaCoded => "sRGB, not linear?".to_owned(),
        Cause::Exponent => format!("power {} of linear values?", significant(s.amount, 2)),
        Cause::Thickness => format!("thickness {}?", amount("mm")),
        Cause::ThicknessesSwapped => "thicknesses exchanged?".to_owned(),
    };
    Some(format!("{goodness}: {short}"))
}
