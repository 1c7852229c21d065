//! The input quantities of a measurement: with type, distribution and standard uncertainty, before and after the fit.

use std::collections::BTreeSet;

use farm_figures::numbers::significant;
use optics_model::fit::{MaterialFit, Nuisance, Refined};
use optics_model::scene::Scope;

/// An input quantity.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct InputQuantity {
    pub name: String,
    /// How many independent values there are.
    pub count: usize,
    pub std_uncertainty: String,
    /// Type A or B.
    pub kind: &'static str,
    pub distribution: &'static str,
    /// Standard uncertainty after the fit; empty if it is not estimated.
    pub posterior: String,
}

/// A quantity under construction, from all fits.
#[derive(Debug, Clone)]
struct GatheredInput {
    name: String,
    unit: String,
    /// Places of the values: channel, slab or material.
    values: BTreeSet<String>,
    /// It is of type A: from observations.
    is_observed: bool,
    distribution: &'static str,
    priors: Vec<f64>,
    posteriors: Vec<f64>,
}

/// The input quantities of all channels, each once. What `farmctl capture` estimates from photographs is of type A.
pub(super) fn input_quantities(fits: &[MaterialFit], is_captured: bool) -> Vec<InputQuantity> {
    let refined: Vec<(usize, &str, &Refined)> = fits
        .iter()
        .enumerate()
        .flat_map(|(i, fit)| {
            fit.channels.iter().filter_map(move |c| Some((i, c.channel.as_str(), c.refined.as_ref()?)))
        })
        .collect();
    let noise: Vec<f64> = refined.iter().map(|(.., r)| r.measurement_noise).collect();
    let mut all = vec![
        InputQuantity {
            name: "radiance factor of a pixel: noise".to_owned(),
            count: noise.len(),
            std_uncertainty: range(&noise, ""),
            kind: "A",
            distribution: "normal",
            posterior: String::new(),
        },
        InputQuantity {
            name: "simulated radiance factor: noise of the dictionary".to_owned(),
            count: noise.len(),
            std_uncertainty: "in each record".to_owned(),
            kind: "A",
            distribution: "normal",
            posterior: String::new(),
        },
    ];
    let mut gathered: Vec<GatheredInput> = Vec::new();
    for (material, channel, r) in &refined {
        for n in &r.likelihood.nuisances {
            let (name, unit) = name_of(n.nuisance);
            let of_slab = n.profile_mm.map(|mm| mm.to_string()).unwrap_or_default();
            let value = match n.nuisance {
                Nuisance::Scale => String::new(),
                Nuisance::BlurVariance => (*channel).to_owned(),
                Nuisance::Thickness => format!("{material} {of_slab}"),
                _ => format!("{material} {channel} {of_slab}"),
            };
            let entry = entry(&mut gathered, name, unit);
            entry.add(value, n.prior_std_error, n.std_error);
            let is_photographed = matches!(n.nuisance, Nuisance::BlurVariance | Nuisance::Origin);
            entry.is_observed |= is_captured && is_photographed || !n.prior_std_error.is_finite();
        }
        for e in &r.likelihood.scene {
            let of_slab = e.slab_mm.map(|mm| mm.to_string()).unwrap_or_default();
            let value = match e.scope {
                Scope::Session => String::new(),
                Scope::Channel => format!("{material} {channel}"),
                Scope::Material | Scope::Slab => format!("{material} {of_slab}"),
            };
            let entry = entry(&mut gathered, &e.quantity, &e.unit);
            entry.add(value, e.prior_std_error, e.std_error);
            entry.distribution = "normal, with wider tails";
        }
    }
    all.extend(gathered.iter().map(GatheredInput::quantity));
    all
}

fn entry<'a>(all: &'a mut Vec<GatheredInput>, name: &str, unit: &str) -> &'a mut GatheredInput {
    let at = all.iter().position(|of| of.name == name).unwrap_or_else(|| {
        let (name, unit) = (name.to_owned(), unit.to_owned());
        all.push(GatheredInput {
            name,
            unit,
            values: BTreeSet::new(),
            is_observed: false,
            distribution: "normal",
            priors: Vec::new(),
            posteriors: Vec::new(),
        });
        all.len() - 1
    });
    &mut all[at]
}

impl GatheredInput {
    fn add(&mut self, value: String, prior: f64, posterior: f64) {
        self.values.insert(value);
        self.priors.push(prior);
        self.posteriors.push(posterior);
    }

    fn quantity(&self) -> InputQuantity {
        let is_free = self.priors.iter().any(|prior| !prior.is_finite());
        InputQuantity {
            name: self.name.clone(),
            count: self.values.len(),
            std_uncertainty: if is_free { "unknown".to_owned() } else { range(&self.priors, &self.unit) },
            kind: if self.is_observed { "A" } else { "B" },
            distribution: self.distribution,
            posterior: range(&self.posteriors, &self.unit),
        }
    }
}

fn name_of(nuisance: Nuisance) -> (&'static str, &'static str) {
    match nuisance {
        Nuisance::Scale => ("white reference: scale factor 1/μ", ""),
        Nuisance::BlurVariance => ("blur of the camera: variance", "mm²"),
        Nuisance::Thickness => ("thickness of a slab", "mm"),
        Nuisance::Origin => ("place of the edge", "mm"),
        Nuisance::Gain => ("gain of a profile", ""),
        Nuisance::Zero => ("zero of a profile", ""),
        Nuisance::Slope => ("slope of the light over 10 mm", ""),
        Nuisance::Wedge => ("slope of a slab's thickness over 10 mm", ""),
    }
}

/// One number, or the least and the greatest.
fn range(values: &[f64], unit: &str) -> String {
    let finite = || values.iter().copied().filter(|v| v.is_finite());
    let (least, most) = (finite().fold(f64::INFINITY, f64::min), finite().fold(0.0, f64::max));
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let [least, most] = [least, most].map(|v| significant(v, 2));
    match values {
        [] => String::new(),
        _ if least == most => format!("{least}{unit}"),
        _ => format!("{least} to {most}{unit}"),
    }
}
