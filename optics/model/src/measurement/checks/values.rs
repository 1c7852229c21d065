//! Checks for values that are not linear radiance factors.

use super::trace::Trace;
use super::{Kind, Seen, edge};

/// Radiance factors above this do not occur: a white slab on a white base has 1, and a measurement whose white reference
/// is off by the factor μ = 0.8 has 1.25.
const LARGEST: f64 = 1.5;
/// This limit for patches, which are one number: fluorescent ones have more at one wavelength.
const LARGEST_OF_PATCH: f64 = 3.0;

const FROM_RAW: &str =
    "take linear raw values, subtract the dark picture and divide by the picture of a white reference";

const EIGHT_BIT: &str = "all values are multiples of 1/255, as from an 8-bit picture";

/// Finds values above 1.5: a refusal if a tenth of the pixels has them, a warning for fewer, as with glints.
pub(super) fn too_large(values: &[f64]) -> Option<Seen> {
    let largest = if values.iter().all(|v| *v == values[0]) { LARGEST_OF_PATCH } else { LARGEST };
    let first = values.iter().position(|v| *v > largest)?;
    let count = values.iter().filter(|v| **v > largest).count();
    let most = values.iter().copied().fold(f64::MIN, f64::max);
    if count * 10 < values.len() {
        let pixels = if count == 1 { "one pixel has".to_owned() } else { format!("{count} pixels have") };
        let text = format!(
            "{pixels} values up to {most}, above {LARGEST}: is it a glint? Leave the profile out or take the picture again"
        );
        return Some(Seen::warning(Kind::BrightPixels, text).at(first));
    }
    let whole = values.iter().all(|v| v.fract() == 0.0);
    let cause = match most {
        m if m > 65_535.0 => format!("these look like counts of a camera: {FROM_RAW}"),
        m if m > 255.0 => format!("these look like pixel values of 10 to 16 bits: {FROM_RAW}"),
        m if m > 110.0 || (whole && m > 3.0) => format!("these look like 8-bit pixel values: {FROM_RAW}"),
        m if m > 3.0 => "these look like per cent: divide by 100".to_owned(),
        _ => "divide by the picture of a white reference under the same light".to_owned(),
    };
    let text = format!(
        "values up to {most}, where linear radiance factors (1 for ideal white) are expected; {cause}"
    );
    Some(Seen::refusal(Kind::ValuesTooLarge, text).at(first))
}

/// Fewest pixels that show how many digits were saved.
const FEWEST: usize = 20;

/// Finds profiles whose values have one decimal, as a spreadsheet saves what it shows: their steps hide the edge.
pub(super) fn too_coarse(values: &[f64]) -> Option<Seen> {
    let is_coarse = |v: &f64| (10.0 * v - (10.0 * v).round()).abs() < 1e-9;
    let is_profile = values.len() >= FEWEST && values.iter().any(|v| *v != values[0]);
    (is_profile && values.iter().all(is_coarse)).then(|| {
        let text = "all values have one decimal, as a spreadsheet shows them: save more digits".to_owned();
        Seen::refusal(Kind::FewDigits, text)
    })
}

/// Finds values that are all multiples of 1/255: an 8-bit picture, which mostly is not linear. A refusal if the shape
/// shows that it is not.
pub(super) fn eight_bit(values: &[f64], trace: &Trace) -> Option<Seen> {
    let mut levels = Vec::with_capacity(values.len());
    for v in values {
        let level = 255.0 * v;
        // Values with five decimals are within this; by chance one value in 25 is.
        if (level - level.round()).abs() > 0.02 {
            return None;
        }
        levels.push(level.round() as i64);
    }
    levels.sort_unstable();
    levels.dedup();
    if levels.len() < 8 {
        return None;
    }
    let raised =
        edge::middle(trace).is_some_and(|m| m.excess > (0.01 * m.contrast).max(0.003) + 3.0 * m.noise);
    if raised {
        let text = format!(
            "{EIGHT_BIT}, and the middle is raised as by the sRGB curve, which no linear profile's is: take linear raw values, or undo the curve before averaging"
        );
        return Some(Seen::refusal(Kind::EightBit, text));
    }
    let text = format!(
        "{EIGHT_BIT}: if it was encoded as sRGB, the values are not linear and the fit will be wrong; take linear raw values, or undo the curve before averaging"
    );
    Some(Seen::warning(Kind::EightBit, text))
}
