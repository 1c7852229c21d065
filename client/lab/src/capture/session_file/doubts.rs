//! Finds values of a session that are valid but implausible.

use optics_model::Invalid;

use super::{SampleTable, SessionFile};
use crate::capture::bands::Band;
use crate::capture::spectrum::Spectrum;
use crate::measurement_file::normal;

/// Largest plausible relative error of certified patches.
const NEUTRAL_STD_ERROR: f64 = 0.1;
/// Plausible squares of boards: with a slab on them they are still visible to a camera.
const SQUARE_MM: std::ops::RangeInclusive<f64> = 5.0..=100.0;
/// Plausible thicknesses of slabs.
const THICKNESS_MM: std::ops::RangeInclusive<f64> = 0.05..=20.0;
/// Least side of a slab whose sides are so far from the edge that they take no light.
const SLAB_MM: f64 = 40.0;
/// Largest plausible relative error of a measured thickness.
const THICKNESS_STD_ERROR: f64 = 0.1;
/// Thicknesses closer than this are probably those of one slab.
const ONE_SLAB_MM: f64 = 1e-3;

/// Share of a band's light outside of the filter's passband from which on it misleads absorptions by more than their
/// usual error.
const STRAY: f64 = 2e-3;

/// All suspicious values, each with its field.
pub(super) fn of(file: &SessionFile) -> Vec<String> {
    let mut doubts = Vec::new();
    if let Some(error) = file.neutral.std_error.filter(|error| *error > NEUTRAL_STD_ERROR) {
        let percent = 100.0 * error;
        doubts.push(format!(
            "neutral.std_error = {error} is {percent:.0} % of each reflectance, as a fraction of 1: certified patches have \
             about 0.01"
        ));
    }
    if let Some(side) = file.target.square_mm.filter(|side| !SQUARE_MM.contains(side)) {
        doubts.push(format!(
            "target.square_mm = {side}: boards have squares of 5 to 100 mm; is it in another unit?"
        ));
    }
    for (i, sample) in file.samples.iter().enumerate() {
        let place = |what: String| format!("sample[{i}].{what}");
        doubts.extend(slab(sample).into_iter().map(place));
        doubts.extend(file.samples[..i].iter().find_map(|before| alike(before, sample)).map(place));
    }
    doubts
}

/// A doubt about a filter that passes light outside of its passband.
pub(super) fn stray(band: &Band, light: Option<&Spectrum>) -> Result<Option<String>, Invalid> {
    let share = band.stray_share(light)?;
    Ok((share > STRAY).then(|| {
        format!(
            "the filter of band {:?} passes {:.1} % of the light outside of its passband: media that absorb in the band \
             look too bright; block it by a second filter",
            band.name,
            100.0 * share
        )
    }))
}

/// Largest difference of the readings of an even slab, as a share.
const EVEN: f64 = 0.01;

fn slab(sample: &SampleTable) -> Vec<String> {
    let thickness = sample.thickness_mm.mean_mm();
    let mut doubts = Vec::new();
    if sample.thickness_mm.range() > EVEN {
        doubts.push(format!(
            "thickness_mm: the readings differ by {:.1} %: turn the slab by 180° between mountings, so that a wedge averages out",
            100.0 * sample.thickness_mm.range()
        ));
    }
    if let Some([width, height]) = sample.slab_mm.filter(|sides| sides.iter().any(|side| *side < SLAB_MM)) {
        doubts.push(format!(
            "slab_mm = [{width}, {height}]: light leaves a slab of less than {SLAB_MM} mm at its sides, and σ_a of clear media \
             is too large, by 20 % at 20 mm with black sides; cast larger slabs"
        ));
    }
    if !THICKNESS_MM.contains(&thickness) {
        doubts.push(format!(
            "thickness_mm = {thickness}: slabs have about 0.5 to 2 mm; is it in another unit?"
        ));
    }
    if let Some(error) =
        sample.thickness_std_error_mm.filter(|error| *error > THICKNESS_STD_ERROR * thickness)
    {
        let percent = 100.0 * error / thickness;
        doubts.push(format!(
            "thickness_std_error_mm = {error} is {percent:.0} % of the thickness; is it in another unit?"
        ));
    }
    doubts
}

/// A doubt about two samples that are probably one.
fn alike(before: &SampleTable, sample: &SampleTable) -> Option<String> {
    let names = [&before.material, &sample.material].map(|name| normal(name).into_owned());
    let (one, other) = (before.thickness_mm.mean_mm(), sample.thickness_mm.mean_mm());
    if names[0] != names[1] && names[0].to_lowercase() == names[1].to_lowercase() {
        return Some(format!("material = {:?} differs from {:?} only in case", names[1], names[0]));
    }
    let close = one != other && (one - other).abs() < ONE_SLAB_MM;
    (names[0] == names[1] && close).then(|| {
        format!("thickness_mm = {other} is nearly that of another slab, {one}; a slab has one [[sample]]")
    })
}
