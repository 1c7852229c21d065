//! Formats a channel's numbers with their intervals, for tables and the page, and collects the remarks on them.

use farm_figures::numbers::{albedo, albedo_end, interval, significant};
use optics_model::fit::{MaterialFit, Refined};
use serde::Serialize;

use super::remarks::{remarks, warnings};

/// A number with its meaningful digits, and its interval of 95 %.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct NumberWithInterval {
    pub(crate) value: String,
    pub(crate) interval: String,
}

/// The numbers of a refined channel.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct ChannelSummary {
    pub(crate) reduced_scattering_per_mm: NumberWithInterval,
    pub(crate) absorption_per_mm: NumberWithInterval,
    pub(crate) sigma_t_per_mm: NumberWithInterval,
    pub(crate) albedo: NumberWithInterval,
    pub(crate) g: NumberWithInterval,
    pub(crate) misfit: String,
}

impl ChannelSummary {
    pub(crate) fn of(r: &Refined) -> Self {
        let three = |v: f64| significant(v, 3);
        let two = |v: f64| significant(v, 2);
        let number = |value, interval| NumberWithInterval { value, interval };
        let m = &r.best.medium;
        Self {
            reduced_scattering_per_mm: number(
                three(m.reduced_scattering_per_mm()),
                interval(&r.reduced_scattering_per_mm, three),
            ),
            absorption_per_mm: number(two(m.absorption_per_mm()), interval(&r.absorption_per_mm, two)),
            sigma_t_per_mm: number(three(m.sigma_t_per_mm()), interval(&r.sigma_t_per_mm, three)),
            albedo: number(albedo(m.albedo()), interval(&r.albedo, albedo_end)),
            g: number(three(m.g()), interval(&r.g, two)),
            misfit: two(r.misfit),
        }
    }
}

/// A remark on some channels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Remark {
    /// Material and channel of each channel concerned.
    pub(crate) about: Vec<String>,
    pub(crate) text: String,
    /// Whether the remark means that the numbers may be wrong.
    pub(crate) warning: bool,
}

/// The remarks on all channels. A remark on several channels appears once.
pub(crate) fn all_remarks(fits: &[MaterialFit]) -> Vec<Remark> {
    let mut said: Vec<Remark> = Vec::new();
    for (fit, channel) in fits.iter().flat_map(|f| f.channels.iter().map(move |c| (f, c))) {
        let who = format!("{} {}", fit.material, channel.channel);
        let warnings = warnings(channel);
        for text in remarks(channel) {
            let warning = warnings.contains(&text);
            match said.iter_mut().find(|other| other.text == text) {
                Some(other) => other.about.push(who.clone()),
                None => said.push(Remark { about: vec![who.clone()], text, warning }),
            }
        }
    }
    said
}
