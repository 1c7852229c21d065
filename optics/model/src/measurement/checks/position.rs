//! Checks for positions and lengths in units other than mm.

use super::{Kind, Seen};
use crate::measurement::is_off_edge;

/// Finds x that counts pixels or is in µm, cm or m. A laboratory's profile spans about 10 mm.
pub(super) fn of_x(x: &[f64]) -> Option<Seen> {
    let n = x.len();
    let (first, last) = (x[0], x[n - 1]);
    let (span, pitch) = (last - first, (last - first) / (n - 1) as f64);
    let range = format!("x runs from {first} to {last}");
    let counted = x.iter().enumerate().all(|(i, x)| (x - first - i as f64).abs() < 1e-6);
    if counted && n >= 16 {
        let text = format!(
            "{range} in steps of 1: these look like pixel numbers: multiply by the pixel pitch in mm, with 0 at the edge"
        );
        let kind = Kind::PixelNumbers;
        return Some(if span >= 50.0 { Seen::refusal(kind, text) } else { Seen::warning(kind, text) });
    }
    if span >= 1000.0 {
        let text = format!("{range}: this looks like µm: divide by 1000 to get mm");
        return Some(Seen::refusal(Kind::UnitOfX, text));
    }
    if span > 100.0 {
        let text = format!("{range} mm, where profiles span about 10 mm: is it another unit?");
        return Some(Seen::warning(Kind::UnitOfX, text));
    }
    // No lens resolves a tenth of the wavelength of light.
    if pitch < 5e-5 {
        let text =
            format!("{range}, {:.3} nm a pixel: this looks like m: multiply by 1000 to get mm", 1e6 * pitch);
        return Some(Seen::refusal(Kind::UnitOfX, text));
    }
    // A profile away from the edge is a patch.
    if span < 1.5 && !is_off_edge(x) {
        let text = format!("{range} mm, where profiles span about 10 mm: if it is cm, multiply by 10");
        return Some(Seen::warning(Kind::UnitOfX, text));
    }
    None
}

/// Finds thicknesses in µm: a laboratory's slabs are about 0.5 to 2 mm thick.
pub(super) fn of_thickness(thickness_mm: f64) -> Option<Seen> {
    let text = |what: &str| format!("the thickness is {thickness_mm} mm: {what}");
    if thickness_mm >= 100.0 {
        let text = text("this looks like µm: divide by 1000 to get mm");
        return Some(Seen::refusal(Kind::UnitOfThickness, text));
    }
    (thickness_mm > 20.0).then(|| Seen::warning(Kind::UnitOfThickness, text("is it another unit?")))
}
