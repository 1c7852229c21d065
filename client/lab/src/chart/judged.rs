//! How well predictions meet patches: differences, bounds, groups by uppermost material, and the worst patches.

use optics_chart::{delta_e_2000, lab};
use serde::Serialize;

use super::patch::{NamedPatch, stack_text};

/// Most patches that are listed as the worst.
const WORST: usize = 10;

/// Differences of patches from what was expected of them.
#[derive(Debug, Clone, Serialize)]
pub struct JudgedChart {
    /// `CIEDE2000`, or `share` for the root mean square of ln(measured/expected) over the channels.
    pub unit: &'static str,
    pub patches: usize,
    pub median: f64,
    pub below_90: f64,
    /// The bound of 95 % of further patches like these: the ⌈0.95 (n + 1)⌉th of n differences.
    pub below_95: f64,
    pub greatest: f64,
    pub by_top: Vec<JudgedGroup>,
    pub worst: Vec<JudgedPatch>,
    /// All differences, in the order of the patches.
    #[serde(skip)]
    pub all: Vec<f64>,
}

/// Patches with one material on top, or of one material.
#[derive(Debug, Clone, Serialize)]
pub struct JudgedGroup {
    pub group: String,
    pub patches: usize,
    pub median: f64,
}

#[derive(Debug, Clone, Serialize)]
pub struct JudgedPatch {
    pub patch: String,
    pub slabs: String,
    pub difference: f64,
    /// CIELAB under D65, or the values by channel.
    pub measured: Vec<f64>,
    pub expected: Vec<f64>,
}

/// The differences of patches; None if there are none.
pub fn judged(patches: &[NamedPatch], expected: &[Vec<f64>], is_colour: bool) -> Option<JudgedChart> {
    let shown = |v: &[f64]| if is_colour { lab([v[0], v[1], v[2]]).to_vec() } else { v.to_vec() };
    let difference = |measured: &[f64], expected: &[f64]| {
        if is_colour {
            let [a, b] = [measured, expected].map(|v| lab([v[0], v[1], v[2]]));
            return delta_e_2000(a, b);
        }
        let ratio = |(m, e): (&f64, &f64)| libm::log(m.max(1e-4) / e.max(1e-4)).powi(2);
        (measured.iter().zip(expected).map(ratio).sum::<f64>() / measured.len() as f64).sqrt()
    };
    let all: Vec<f64> = patches.iter().zip(expected).map(|(p, e)| difference(&p.values, e)).collect();
    let sorted = ascending(&all);
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.sort_by(|a, b| all[*b].total_cmp(&all[*a]));
    let worst = order.iter().take(WORST).map(|i| JudgedPatch {
        patch: patches[*i].name.clone(),
        slabs: stack_text(&patches[*i].slabs),
        difference: all[*i],
        measured: shown(&patches[*i].values),
        expected: shown(&expected[*i]),
    });
    let mut groups: Vec<String> = Vec::new();
    let names: Vec<String> = patches.iter().map(group).collect();
    groups.extend(names.iter().cloned());
    groups.sort();
    groups.dedup();
    let by_top = groups.into_iter().map(|group| {
        let own: Vec<f64> = all.iter().zip(&names).filter(|(_, of)| **of == group).map(|(d, _)| *d).collect();
        let median = median(&ascending(&own));
        JudgedGroup { patches: own.len(), median, group }
    });
    Some(JudgedChart {
        unit: if is_colour { "CIEDE2000" } else { "share" },
        patches: all.len(),
        median: median(&sorted),
        below_90: quantile(&sorted, 0.9),
        below_95: quantile(&sorted, 0.95),
        greatest: *sorted.last()?,
        by_top: by_top.collect(),
        worst: worst.collect(),
        all,
    })
}

fn ascending(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

fn median(sorted: &[f64]) -> f64 {
    let middle = sorted.len() / 2;
    if sorted.len().is_multiple_of(2) { 0.5 * (sorted[middle - 1] + sorted[middle]) } else { sorted[middle] }
}

/// The ⌈q (n + 1)⌉th of n values; the greatest if there are too few.
fn quantile(sorted: &[f64], q: f64) -> f64 {
    let place = (q * (sorted.len() + 1) as f64).ceil() as usize;
    sorted.get(place.saturating_sub(1)).or(sorted.last()).copied().unwrap_or(f64::NAN)
}

fn group(patch: &NamedPatch) -> String {
    let name = |i: usize| patch.slabs[i].shares[0].0.clone();
    if (1..patch.slabs.len()).all(|i| name(i) == name(0)) {
        return format!("{} alone", name(0));
    }
    format!("{} on top", name(0))
}
