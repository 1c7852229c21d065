//! Measures how the light over the board differs from that of the flat shots, by the board's light squares.

use super::patch::PatchRadiance;
use crate::least_squares::{FittedParameters, robust_fit};
use crate::light_field::LightField;

/// Standard deviation of the reflectance of a printed board: its slope per 10 mm.
pub(crate) const BOARD_SLOPE: f64 = 0.001;

/// Fewest light patches, and the largest standard error of a slope, with which a field counts as seen; twice that of bends.
const PATCHES: usize = 12;
const SEEN: f64 = 0.002;

/// Standard errors, with the board's own slope, beyond which the field is corrected.
const CERTAIN: f64 = 3.0;

/// The field of each column by the patches of a bare shot.
pub(crate) fn fields(patches: &[PatchRadiance]) -> Vec<LightField> {
    let columns = patches.first().map_or(0, |patch| patch.means.len());
    (0..columns).map(|c| field(patches, c).unwrap_or_default()).collect()
}

fn field(patches: &[PatchRadiance], c: usize) -> Option<LightField> {
    let light = patches.iter().filter(|p| p.is_light && p.means[c].value > 0.0);
    let point = |p: &PatchRadiance| {
        let [x, y] = p.place;
        ([1.0, x, y, x * x, x * y, y * y], libm::log(p.means[c].value))
    };
    let points: Vec<_> = light.map(point).collect();
    if points.len() < PATCHES {
        return None;
    }
    let bent = robust_fit(&points, 8);
    let straight: Vec<_> = points.iter().map(|(row, value)| ([row[0], row[1], row[2]], *value)).collect();
    let straight = robust_fit(&straight, 8);
    // Patches on few lines do not determine a bend, or a slope along them.
    let is_seen = |(found, sigma): &(FittedParameters, f64)| {
        (1..found.x.len()).all(|i| found.std_error(i) * sigma < if i < 3 { SEEN } else { 2.0 * SEEN })
    };
    let (found, sigma) = bent.filter(is_seen).or_else(|| straight.filter(is_seen))?;
    let value = |i: usize| if i < found.x.len() { found.x[i] } else { 0.0 };
    let error = |i: usize| libm::hypot(sigma * found.std_error(i), BOARD_SLOPE);
    let is_certain = (1..found.x.len()).any(|i| value(i).abs() > CERTAIN * error(i));
    let coefficients = std::array::from_fn(|i| if is_certain { value(i + 1) } else { 0.0 });
    let lost = if is_certain { 0.0 } else { value(1) };
    Some(LightField { coefficients, slope_std_error: libm::hypot(error(1), lost) })
}
