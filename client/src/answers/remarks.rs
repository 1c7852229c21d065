//! Remarks that restrict the use of a fit's numbers, and warnings about fits that noise does not explain.

use farm_figures::misfit::{goodness, is_unlikely};
use farm_figures::numbers::significant;
use farm_lab::document::Remark;
use optics_model::fit::{Cause, ChannelFit, Interval, MaterialFit, Outside, Refined, Suspicion};

use super::likelihood::{findings, too_quiet};

/// The remarks on all channels. A remark on several channels appears once.
pub(crate) fn all_remarks(fits: &[MaterialFit]) -> Vec<Remark> {
    let mut said: Vec<Remark> = Vec::new();
    for (fit, channel) in fits.iter().flat_map(|f| f.channels.iter().map(move |c| (f, c))) {
        let who = format!("{} {}", fit.material, channel.channel);
        for (text, warning) in remarks(channel) {
            match said.iter_mut().find(|other| other.text == text) {
                Some(other) => other.about.push(who.clone()),
                None => said.push(Remark { about: vec![who.clone()], text, warning }),
            }
        }
    }
    said
}

/// All remarks on a channel's numbers, the warnings first, and whether each is a warning.
pub(super) fn remarks(channel: &ChannelFit) -> Vec<(String, bool)> {
    let mut notes = channel.refined.as_ref().map(findings).unwrap_or_default();
    if channel.refined.as_ref().is_some_and(Refined::g_is_open) {
        notes.push("g open: σ_t and α are valid for this g only".to_owned());
    }
    if channel.refined.as_ref().is_some_and(|r| r.valley) {
        notes.push("σ_t and g trade off: trust σ_s(1−g) and σ_a".to_owned());
    }
    let warnings = warnings(channel).into_iter().map(|text| (text, true));
    warnings.chain(notes.into_iter().map(|text| (text, false))).collect()
}

/// Reasons why the numbers may be wrong.
fn warnings(channel: &ChannelFit) -> Vec<String> {
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
        "unresolved: σ_t may lie {side} {} /mm, where the dictionary or the given bound ends; compute a wider dictionary, or \
         give g",
        significant(end, 3)
    )
}

/// `χ² 1130 of 716, …` with the most likely reason; `None` if noise explains the fit.
pub(super) fn misfit(refined: &Refined) -> Option<String> {
    let suspicion = refined.suspicion.as_ref();
    if !is_unlikely(&refined.likelihood) {
        // The media absorb the error, so that χ² does not show it.
        return suspicion.map(|s| {
            let text = "the intervals are not to be trusted, although χ² is small";
            format!("{text}: the measurements contradict the set-up as given; {}", reason(s))
        });
    }
    let reason = suspicion.map_or_else(String::new, |s| match s.cause {
        Cause::Unknown => format!("; {}", reason(s)),
        _ => format!("; {} (misfit {} without that)", reason(s), significant(s.misfit_left, 2)),
    });
    let meaning = "noise and the priors of the set-up do not explain the data; the intervals were widened and may \
                   still be wrong";
    Some(format!("{}: {meaning}{reason}", goodness(&refined.likelihood)))
}

fn reason(s: &Suspicion) -> String {
    let place = s.thickness_mm.map_or("all profiles".to_owned(), |t| format!("the profile of {t} mm"));
    let size = |digits| significant(s.amount.abs(), digits);
    let percent = significant(100.0 * s.amount.abs(), 2);
    let (large, rises) = if s.amount > 0.0 { ("large", "brighter") } else { ("small", "darker") };
    let thicker = if s.amount > 0.0 { "thicker" } else { "thinner" };
    match s.cause {
        Cause::Unknown => {
            "no single cause explains it: check edge, light, thicknesses, channels, the scene's \
                           reflectances, and whether this material fits the scene"
                .to_owned()
        }
        Cause::EdgeOffset => format!(
            "most likely cause: an edge at x = {} mm instead of 0 in {place}; shift its x_mm",
            significant(s.amount, 2)
        ),
        Cause::Gain => format!(
            "most likely cause: values {percent} % too {large} in {place}; check exposure and white reference"
        ),
        Cause::Zero => format!(
            "most likely cause: values too {large} by {} in {place}; check black level and stray light",
            size(2)
        ),
        Cause::Slope => format!(
            "most likely cause: light that gets {percent} % {rises} from dark to light side in {place}; divide by a flat field"
        ),
        Cause::Wedge => format!(
            "most likely cause: a wedge, a slab that gets {percent} % {thicker} from dark to light side in {place}; turn it by \
             180° for half of its shots, or measure its thickness at both ends"
        ),
        Cause::Blur => format!(
            "most likely cause: a camera that blurs by {} mm (standard deviation) in {place}; focus, or use a smaller aperture",
            size(2)
        ),
        Cause::GammaCoded => {
            "most likely cause: values coded for a screen (sRGB); develop the photographs linearly".to_owned()
        }
        Cause::Exponent => format!(
            "most likely cause: values that are the power {} of linear ones, as from a camera's curve or coding for a \
             screen (sRGB: 0.45); develop the photographs linearly",
            size(2)
        ),
        Cause::Thickness => format!(
            "most likely cause: a slab of {} mm in {place}; measure its thickness again",
            significant(s.amount, 3)
        ),
        Cause::ThicknessesSwapped => {
            "most likely cause: exchanged thicknesses; check thickness_mm".to_owned()
        }
    }
}
