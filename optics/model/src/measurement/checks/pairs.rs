//! Checks of pairs of profiles.

use super::edge::SURE;
use super::trace::Trace;
use super::{Finding, Kind, MeasuredProfile, Measurement, Seen};
use crate::measurement::colour;

/// Checks the pairs of one material: the same values twice, and thicknesses that contradict each other.
pub(super) fn of_material(material: usize, profiles: &[MeasuredProfile], sound: &[bool]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (j, second) in profiles.iter().enumerate() {
        let seen = profiles[..j].iter().enumerate().find_map(|(i, first)| {
            if first.values() == second.values() {
                return same(first, second);
            }
            let comparable = sound[i] && sound[j] && first.channel() == second.channel();
            if !comparable {
                return None;
            }
            if first.thickness_mm() < second.thickness_mm() {
                order(first, second)
            } else {
                order(second, first)
            }
        });
        findings.extend(seen.map(|s| s.of(material, j)));
    }
    findings
}

/// Finds the same values under two names. Photographs never agree in their noise; traced profiles of two channels do
/// where the base is not seen, or reflects the same in both, as it may at two wavelengths.
fn same(first: &MeasuredProfile, second: &MeasuredProfile) -> Option<Seen> {
    let trace = Trace::new(second.x_mm(), second.values(), None);
    let n = trace.len();
    let (dark, light) = (trace.level(0..n / 4), trace.level(n - n / 4..n));
    if (light - dark).abs() < 1e-3 * light.abs() {
        return None;
    }
    let text = format!(
        "the values are those of channel {} at {} mm, number for number: one of the two is not what it is called",
        first.channel(),
        first.thickness_mm()
    );
    let slabs = first.thickness_mm() != second.thickness_mm();
    let colours = colour(first.channel()).is_some() && colour(second.channel()).is_some();
    Some(if slabs || colours {
        Seen::refusal(Kind::SameValues, text)
    } else {
        Seen::warning(Kind::SameValues, text)
    })
}

/// Finds the same values under the names of two materials.
pub(super) fn across(materials: &[Measurement]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (m, material) in materials.iter().enumerate() {
        // A patch is one number, which two materials may share.
        let is_one_number = |values: &[f64]| values.iter().all(|v| *v == values[0]);
        for (p, profile) in material.profiles().iter().enumerate().filter(|(_, p)| !is_one_number(p.values()))
        {
            let twin = materials[..m]
                .iter()
                .find(|other| other.profiles().iter().any(|o| o.values() == profile.values()));
            findings.extend(twin.map(|other| {
                let text = format!(
                    "the values are those of material {}, number for number: is it the same sample?",
                    other.material()
                );
                Seen::warning(Kind::SameValues, text).of(m, p)
            }));
        }
    }
    findings
}

/// Contrast of the edge as seen through a slab.
struct EdgeContrast {
    /// Light less dark level next to the edge.
    rise: f64,
    /// Light less dark level far from the edge.
    ends: f64,
    noise: f64,
}

impl EdgeContrast {
    /// `reach` is the distance that both profiles cover, `width` the width of the windows next to the edge.
    fn of(trace: &Trace, reach: f64, width: f64) -> Option<Self> {
        let (edge, pixels) = (trace.edge(), trace.pixels(width, 3));
        if edge < pixels || edge + pixels > trace.len() {
            return None;
        }
        let outer = trace.pixels(0.5 * reach, 3);
        let last = trace.pixels(reach, 3).min(edge).min(trace.len() - edge);
        if last <= outer {
            return None;
        }
        let ends =
            trace.level(edge + last - outer..edge + last) - trace.level(edge - last..edge - last + outer);
        Some(Self { rise: trace.rise(edge, pixels), ends, noise: trace.noise(pixels) })
    }
}

/// Finds a slab that shows more of the edge than a thinner one of the same medium.
///
/// Apart from gel and glass, a profile depends on σ_t t, α, g and x/t alone: more thickness reduces contrast and blurs.
/// Among the traced media, 1 mm shows at most 0.90 of the rise that 0.5 mm shows next to the edge, and 0.95 of that far
/// from it; swapped, twice the rise is common.
fn order(thin: &MeasuredProfile, thick: &MeasuredProfile) -> Option<Seen> {
    let (a, b) = (Trace::of(thin), Trace::of(thick));
    let reach = a.reach().min(b.reach());
    let width = (0.5f64).max(3.0 * a.pitch.max(b.pitch));
    if reach < 2.0 * width {
        return None;
    }
    let (a, b) = (EdgeContrast::of(&a, reach, width)?, EdgeContrast::of(&b, reach, width)?);
    let noise = SURE * libm::hypot(a.noise, b.noise);
    let exceeds = |rise: f64, ends: f64| {
        // Uneven light may cause a contrast of 0.02.
        b.rise > (rise * a.rise).max(0.02) + noise && b.ends > (ends * a.ends).max(0.02)
    };
    let finding = format!(
        "the slab of {} mm shows more of the edge than that of {} mm ({:.3} against {:.3} of rise next to it)",
        thick.thickness_mm(),
        thin.thickness_mm(),
        b.rise,
        a.rise
    );
    if exceeds(1.3, 1.0) {
        let text = format!(
            "{finding}, which no medium does: their thicknesses are swapped, or one of the pictures is of another material"
        );
        return Some(Seen::refusal(Kind::ThicknessOrder, text));
    }
    exceeds(1.1, 1.0).then(|| {
        let text =
            format!("{finding}: are the thicknesses swapped, or the pictures of different brightness?");
        Seen::warning(Kind::ThicknessOrder, text)
    })
}
