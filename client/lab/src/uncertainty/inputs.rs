//! The input quantities of a measurement: with type, distribution and standard uncertainty, before and after the fit.

use std::collections::BTreeSet;

use farm_figures::numbers::significant;
use optics_model::fit::{MaterialFit, Nuisance, NuisanceEstimate, Refined, SceneEstimate};
use optics_model::scene::Scope;

/// Columns of the table.
pub(super) const HEAD: &str =
    "input quantity | >values | standard uncertainty | type | distribution | after the fit";

/// An estimate of an input quantity in a channel.
struct InputEstimate {
    name: String,
    unit: String,
    /// The channel, slab or material of the value: channels of a slab share its thickness.
    place: String,
    /// It is of type A: from observations.
    is_observed: bool,
    distribution: &'static str,
    /// Standard uncertainties before and after the fit.
    prior: f64,
    posterior: f64,
}

/// A row for each input quantity of all channels. What `farmctl capture` estimates from photographs is of type A.
pub(super) fn input_rows(fits: &[MaterialFit], is_captured: bool) -> Vec<Vec<String>> {
    let channels = fits.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c)));
    let refined: Vec<(&str, &str, &Refined)> = channels
        .filter_map(|(fit, c)| Some((fit.material.as_str(), c.channel.as_str(), c.refined.as_ref()?)))
        .collect();
    let noise: Vec<f64> = refined.iter().map(|(.., r)| r.measurement_noise).collect();
    let noise_row = |name: &str, std_uncertainty: &str| {
        [name, &noise.len().to_string(), std_uncertainty, "A", "normal", ""].map(str::to_owned).to_vec()
    };
    let mut rows = vec![
        noise_row("radiance factor of a pixel: noise", &range(noise.iter().copied(), "")),
        noise_row("simulated radiance factor: noise of the dictionary", "in each record"),
    ];
    let mut all: Vec<InputEstimate> = refined
        .iter()
        .flat_map(|(material, channel, r)| estimates(material, channel, r, is_captured))
        .collect();
    while let Some(first) = all.first() {
        let name = first.name.clone();
        let (same, others): (Vec<_>, Vec<_>) = all.into_iter().partition(|estimate| estimate.name == name);
        rows.push(row(&same));
        all = others;
    }
    rows
}

fn estimates(material: &str, channel: &str, r: &Refined, is_captured: bool) -> Vec<InputEstimate> {
    let slab = |mm: Option<f64>| mm.map(|mm| mm.to_string()).unwrap_or_default();
    let nuisance = |n: &NuisanceEstimate| {
        let (name, unit) = name_of(n.nuisance);
        let is_photographed = matches!(n.nuisance, Nuisance::BlurVariance | Nuisance::Origin);
        InputEstimate {
            name: name.to_owned(),
            unit: unit.to_owned(),
            place: match n.nuisance {
                Nuisance::Scale => String::new(),
                Nuisance::BlurVariance => channel.to_owned(),
                Nuisance::Thickness => format!("{material} {}", slab(n.profile_mm)),
                _ => format!("{material} {channel} {}", slab(n.profile_mm)),
            },
            is_observed: is_captured && is_photographed || !n.prior_std_error.is_finite(),
            distribution: "normal",
            prior: width(n, n.prior_std_error),
            posterior: width(n, n.std_error),
        }
    };
    let scene = |e: &SceneEstimate| InputEstimate {
        name: e.quantity.clone(),
        unit: e.unit.clone(),
        place: match e.scope {
            Scope::Session => String::new(),
            Scope::Channel => format!("{material} {channel}"),
            Scope::Material | Scope::Slab => format!("{material} {}", slab(e.slab_mm)),
        },
        is_observed: false,
        distribution: "normal, with wider tails",
        prior: e.prior_std_error,
        posterior: e.std_error,
    };
    let l = &r.likelihood;
    l.nuisances.iter().map(nuisance).chain(l.scene.iter().map(scene)).collect()
}

/// The estimates of one quantity.
fn row(all: &[InputEstimate]) -> Vec<String> {
    let InputEstimate { name, unit, distribution, .. } = &all[0];
    let is_free = all.iter().any(|estimate| !estimate.prior.is_finite());
    let prior = range(all.iter().map(|estimate| estimate.prior), unit);
    let places: BTreeSet<&String> = all.iter().map(|estimate| &estimate.place).collect();
    vec![
        name.clone(),
        places.len().to_string(),
        if is_free { "unknown".to_owned() } else { prior },
        if all.iter().any(|estimate| estimate.is_observed) { "A" } else { "B" }.to_owned(),
        (*distribution).to_owned(),
        range(all.iter().map(|estimate| estimate.posterior), unit),
    ]
}

/// The standard uncertainty of a quantity by that of its nuisance: the blur σ, in µm, has a variance in mm² as nuisance.
fn width(n: &NuisanceEstimate, std_error: f64) -> f64 {
    if n.nuisance != Nuisance::BlurVariance {
        return std_error;
    }
    let variance = n.value.max(0.0);
    1e3 * ((variance + std_error).sqrt() - variance.sqrt())
}

fn name_of(nuisance: Nuisance) -> (&'static str, &'static str) {
    match nuisance {
        Nuisance::Scale => ("white reference: scale factor 1/μ", ""),
        Nuisance::BlurVariance => ("blur of the camera", "µm"),
        Nuisance::Thickness => ("thickness of a slab", "mm"),
        Nuisance::Origin => ("place of the edge", "mm"),
        Nuisance::Gain => ("gain of a profile", ""),
        Nuisance::Zero => ("zero of a profile", ""),
        Nuisance::Slope => ("slope of the light over 10 mm", ""),
        Nuisance::Wedge => ("slope of a slab's thickness over 10 mm", ""),
    }
}

/// One number, or the least and the greatest of those that are finite.
fn range(values: impl Iterator<Item = f64>, unit: &str) -> String {
    let finite: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let least = finite.iter().copied().fold(f64::INFINITY, f64::min);
    let most = finite.iter().copied().fold(0.0, f64::max);
    let [least, most] = [least, most].map(|v| significant(v, 2));
    let numbers = if least == most { least } else { format!("{least} to {most}") };
    if finite.is_empty() { String::new() } else { format!("{numbers} {unit}").trim_end().to_owned() }
}
