//! How well a fit explains its measurement, in a few words.

use optics_model::fit::{Cause, Likelihood, MISFIT, Refined, Suspicion};

use crate::numbers::significant;

/// Probability of χ² below which noise and what is known of the set-up do not explain a measurement.
const UNLIKELY: f64 = 1e-3;

/// Whether noise explains the residuals; none if the paper's distance was minimised.
pub fn unlikely(refined: &Refined) -> Option<bool> {
    refined.likelihood.as_ref().map(|l| l.probability < UNLIKELY)
}

/// `χ² 712 of 716, p = 0.53`.
pub fn goodness(l: &Likelihood) -> String {
    let p = if l.probability < UNLIKELY {
        format!("p < {UNLIKELY}")
    } else {
        format!("p = {}", significant(l.probability, 2))
    };
    format!("χ² {:.0} of {:.0}, {p}", l.chi2, l.degrees_of_freedom)
}

/// The goodness of fit, if noise does not explain the residuals.
pub fn unexplained(refined: &Refined) -> Option<String> {
    match &refined.likelihood {
        Some(likelihood) => (unlikely(refined) == Some(true)).then(|| goodness(likelihood)),
        None => (refined.misfit > MISFIT).then(|| format!("misfit {}", significant(refined.misfit, 2))),
    }
}

/// The cause of an error that the media absorb, so that χ² does not show it.
pub fn absorbed_by_media(refined: &Refined) -> Option<&Suspicion> {
    refined.likelihood.as_ref().and(refined.suspicion.as_ref())
}

/// Goodness of fit and most likely cause in few words, for figures; none if noise explains the fit.
pub fn misfit_short(refined: &Refined) -> Option<String> {
    let goodness = match unexplained(refined) {
        Some(goodness) => goodness,
        None => absorbed_by_media(refined).map(|_| "not to be trusted".to_owned())?,
    };
    let Some(s) = &refined.suspicion else { return Some(format!("{goodness}: not explained")) };
    let amount = |unit: &str| format!("{} {unit}", significant(s.amount, 2));
    let percent = format!("{} %", significant(100.0 * s.amount, 2));
    let short = match s.cause {
        Cause::Unknown => return Some(format!("{goodness}: not explained")),
        Cause::EdgeOffset => format!("edge {} off?", amount("mm")),
        Cause::Gain => format!("values {percent} off?"),
        Cause::Zero => format!("zero {} off?", significant(s.amount, 2)),
        Cause::Slope => format!("slope {percent}?"),
        Cause::Blur => format!("blur {}?", amount("mm")),
        Cause::Outliers => format!("{} outliers?", s.amount),
        Cause::GammaCoded => "sRGB, not linear?".to_owned(),
        Cause::Exponent => format!("power {} of linear values?", significant(s.amount, 2)),
        Cause::ThicknessesSwapped => "thicknesses exchanged?".to_owned(),
    };
    Some(format!("{goodness}: {short}"))
}
