//! The error budget through to the media: what each source of error contributes, and which one to improve first.
//!
//! From the information that the pixels hold (Cramér and Rao): a source contributes what the variance of a quantity loses
//! if the source is known exactly. Sources that trade off against each other make such parts add up to less than all.

use anyhow::Result;
use farm_proto::wire::DesignRequest;
use optics_model::fit::{
    ChannelFit, Design, DesignQuestion, DesignSettings, FitOptions, FitSettings, HalfWidths, Improvement,
    Limitation, SlabSet,
};
use optics_model::measurement::MeasuredProfile;
use optics_model::{Measurement, Medium};
use serde::Serialize;

use crate::connection::Connection;
use crate::output::wrapped;
use crate::set_up::SetUp;

/// What the errors of one channel's medium are made of, g held. Half-widths of 95 % intervals.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct MediumErrors {
    material: String,
    channel: String,
    /// Relative.
    sigma_t: f64,
    /// Relative, of 1 − α.
    co_albedo: f64,
    sources: Vec<SourcePart>,
}

/// A source's part, in the same units.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct SourcePart {
    source: &'static str,
    sigma_t: f64,
    co_albedo: f64,
}

/// The parts for one channel; none if the data leave it open.
pub(in crate::commands) async fn medium_errors(
    connection: &Connection,
    dictionary: &str,
    measured: &Measurement,
    fit: &ChannelFit,
    set_up: &SetUp,
    known: &FitSettings,
) -> Result<Option<MediumErrors>> {
    let Some(refined) = fit.refined.as_ref().filter(|refined| refined.resolved) else { return Ok(None) };
    let profiles: Vec<&MeasuredProfile> =
        measured.profiles().iter().filter(|p| p.channel() == fit.channel).collect();
    let Some(noise) = relative_noise(&profiles) else { return Ok(None) };
    let medium = refined.best.medium;
    let settings = set_up.settings_of(*known, Some(&fit.channel))?;
    let question = DesignQuestion::new(DesignSettings {
        channel: Some(fit.channel.clone()),
        slab_sets: vec![profiles.iter().map(|p| p.thickness_mm()).collect()],
        // The errors of profiles are those of all their shots together.
        shots: vec![1],
        noise,
        noise_floor: 0.0,
        set_up: FitOptions::new(settings)?,
        ..DesignSettings::of(medium)
    })?;
    let request = DesignRequest { dictionary: dictionary.to_owned(), ..(&question).into() };
    // What cannot be asked, such as a medium at the dictionary's rim, has no budget, but a fit all the same.
    let Ok(answer) = connection.fits().design(request).await else { return Ok(None) };
    let design = Design::try_from(answer.into_inner())?;
    let parts = design.sets.first().map(|set| parts(set, &medium));
    Ok(parts.map(|(all, sources)| MediumErrors {
        material: measured.material().to_owned(),
        channel: fit.channel.clone(),
        sigma_t: all[0],
        co_albedo: all[1],
        sources,
    }))
}

/// Root mean square of the pixels' errors, relative to the brightness of each; none without errors.
fn relative_noise(profiles: &[&MeasuredProfile]) -> Option<f64> {
    let mut squares = Vec::new();
    for profile in profiles {
        let errors = profile.std_errors()?;
        // Bins that tell nothing count for nothing.
        let told =
            profile.values().iter().zip(errors).filter(|(value, error)| **value > 0.0 && **error < 0.5);
        squares.extend(told.map(|(value, error)| (error / value).powi(2)));
    }
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    (mean > 0.0).then(|| mean.sqrt().clamp(1e-6, 1.0))
}

fn parts(set: &SlabSet, medium: &Medium) -> ([f64; 2], Vec<SourcePart>) {
    let relative = |w: &HalfWidths| [w.of_sigma_t(medium), w.of_co_albedo(medium)];
    let all = relative(&set.g_held);
    let part = |improvement: &Improvement| {
        // Noise never ends: four times the shots take three quarters of its variance.
        let (left, share) = match (improvement.removed, improvement.halved) {
            (Some(removed), _) => (relative(&removed), 1.0),
            (None, Some(halved)) => (relative(&halved), 0.75),
            (None, None) => (all, 1.0),
        };
        let taken = |i: usize| ((all[i].powi(2) - left[i].powi(2)).max(0.0) / share).sqrt();
        SourcePart { source: name(improvement.limitation), sigma_t: taken(0), co_albedo: taken(1) }
    };
    (all, set.improvements.iter().map(part).collect())
}

fn name(limitation: Limitation) -> &'static str {
    match limitation {
        Limitation::Noise => "noise",
        Limitation::Thickness => "thickness",
        Limitation::Origin => "origin",
        Limitation::Blur => "blur",
        Limitation::Gain => "gain of each profile",
        Limitation::Zero => "zero",
        Limitation::Slope => "slope of the light",
        Limitation::Scale => "white reference",
    }
}

/// For people: a line for each channel, and what to improve first.
pub(crate) fn text(errors: &[MediumErrors]) -> Option<String> {
    if errors.is_empty() {
        return None;
    }
    let mut text = "what the errors of σ_t are made of, g held (95 %)".to_owned();
    for e in errors {
        let mut sources: Vec<&SourcePart> =
            e.sources.iter().filter(|s| s.sigma_t > 0.05 * e.sigma_t).collect();
        sources.sort_by(|a, b| b.sigma_t.total_cmp(&a.sigma_t));
        let parts: Vec<String> =
            sources.iter().map(|s| format!("{} {:.2} %", s.source, 100.0 * s.sigma_t)).collect();
        let line =
            format!("{} {}: ± {:.2} %: {}", e.material, e.channel, 100.0 * e.sigma_t, parts.join(", "));
        text += &format!("\n{}", wrapped(&line));
    }
    if let Some((source, share)) = first(errors) {
        let line =
            format!("to improve first: {source}, {:.0} % of the variance of σ_t on average", 100.0 * share);
        text += &format!("\n{}", wrapped(&line));
    }
    Some(text)
}

/// The source with the largest part of σ_t's variance, over all channels.
fn first(errors: &[MediumErrors]) -> Option<(&'static str, f64)> {
    let names: Vec<&'static str> = errors.first()?.sources.iter().map(|s| s.source).collect();
    let share = |name: &str| {
        let of = |e: &MediumErrors| {
            let part = e.sources.iter().find(|s| s.source == name).map_or(0.0, |s| s.sigma_t);
            (part / e.sigma_t).powi(2)
        };
        errors.iter().map(of).sum::<f64>() / errors.len() as f64
    };
    names.into_iter().map(|name| (name, share(name))).max_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(channel: &str, thickness: f64, noise: f64) -> MediumErrors {
        let part = |source, sigma_t| SourcePart { source, sigma_t, co_albedo: 0.0 };
        MediumErrors {
            material: "white".into(),
            channel: channel.into(),
            sigma_t: thickness.hypot(noise),
            co_albedo: 0.1,
            sources: vec![part("thickness", thickness), part("noise", noise), part("zero", 0.0)],
        }
    }

    #[test]
    fn the_largest_source_over_all_channels_is_the_first_to_improve() {
        assert_eq!(text(&[]), None);
        let told = text(&[errors("R", 0.03, 0.04), errors("G", 0.12, 0.05)]).unwrap();
        assert!(told.contains("white R: ± 5.00 %: noise 4.00 %, thickness 3.00 %\n"), "{told}");
        assert!(
            told.ends_with("to improve first: thickness, 61 % of the variance of σ_t on average"),
            "{told}"
        );
    }
}
