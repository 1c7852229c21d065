//! Estimates the size of a request's answer and work before any of it is done, and refuses requests that are too large.

use optics_fit::channels_called;
use optics_model::fit::{DesignQuestion, FitOptions};
use optics_model::{Grid, Invalid, Measurement};

/// Bytes of a neighbour in an answer, and of each of its thicknesses.
const NEIGHBOUR_BYTES: usize = 96;
const THICKNESS_BYTES: usize = 48;
/// Bytes of a pixel of a curve: its value and its gradient.
const PIXEL_BYTES: usize = 16;
/// Most pixels of all profiles of a design: those of each set of slabs count for each number of shots.
const DESIGN_PIXELS: usize = 1 << 24;
/// Largest number of slab sets that are generated if none are given.
const SETS_MADE_UP: usize = 25;
/// Number of slabs in a generated set.
const SLABS_MADE_UP: usize = 3;

/// Refuses a question whose answer would have more than `most` bytes.
pub(super) fn check_answer(
    grid: &Grid,
    materials: &[Measurement],
    options: &FitOptions,
    most: usize,
) -> Result<(), Invalid> {
    let settings = options.settings();
    // A neighbour is a medium of the dictionary, with records of all thicknesses.
    let media = grid.record_count() / grid.thickness_mm().len().max(1);
    let neighbours = (settings.top as usize).min(media);
    let pixels = if settings.curves { grid.scene().sensor().pixels() } else { 0 };
    // In addition to the neighbours' curves, there are the positions, the measured values, and the curve of the refined
    // fit.
    let curves = |profiles: usize| profiles * pixels * PIXEL_BYTES * (neighbours + 3);
    let material_bytes = |material: &Measurement| {
        let channels = channels_called(grid, material.channels()).len();
        let profiles = material.profiles().len();
        channels * neighbours * NEIGHBOUR_BYTES + profiles * neighbours * THICKNESS_BYTES + curves(profiles)
    };
    let bytes: usize = materials.iter().map(material_bytes).sum();
    if bytes <= most {
        return Ok(());
    }
    let (mib, most) = (bytes.div_ceil(1 << 20), most >> 20);
    let given = format!("{} for an answer of {mib} MiB", settings.top);
    let allowed = format!(
        "answers may have {most} MiB: ask for fewer neighbours, without curves, or about fewer materials"
    );
    Err(Invalid::new("options.top", given, allowed))
}

/// Refuses a design that would occupy all cores for a long time.
pub(super) fn check_design(grid: &Grid, question: &DesignQuestion) -> Result<(), Invalid> {
    let settings = question.settings();
    let pixels = settings.pixels.map_or_else(|| grid.scene().sensor().pixels(), |row| row.count());
    let slabs = match settings.slab_sets.iter().map(Vec::len).sum() {
        0 => SETS_MADE_UP * SLABS_MADE_UP,
        slabs => slabs,
    };
    let work = slabs.saturating_mul(settings.shots.len()).saturating_mul(pixels);
    if work <= DESIGN_PIXELS {
        return Ok(());
    }
    let given = format!("{slabs} slabs with {} numbers of shots and {pixels} pixels", settings.shots.len());
    let allowed = format!(
        "at most {DESIGN_PIXELS} pixels in all may be requested: request fewer sets at a time, or coarser pixels"
    );
    Err(Invalid::new("slab_sets", given, allowed))
}

#[cfg(test)]
mod tests {
    use optics_model::Medium;
    use optics_model::fit::{DesignSettings, FitSettings, PixelRow};
    use optics_model::measurement::MeasuredProfile;

    use super::*;

    const MOST: usize = 64 << 20;

    fn options(top: u32, curves: bool) -> FitOptions {
        FitOptions::new(FitSettings { top, curves, ..FitSettings::default() }).unwrap()
    }

    fn material(grid: &Grid) -> Measurement {
        let x: Vec<f64> = (0..8).map(f64::from).collect();
        let profile =
            |channel: &str, mm: f64| MeasuredProfile::new(channel, mm, x.clone(), x.clone(), None).unwrap();
        let channels = grid.scene().channels().iter();
        let profiles = channels.flat_map(|c| grid.thickness_mm().iter().map(|mm| profile(c.name(), *mm)));
        Measurement::new("white", profiles.collect()).unwrap()
    }

    /// A fit whose answer would exceed the size limit is refused before it is calculated.
    #[test]
    fn fit_with_too_large_answer_is_refused() {
        let grid = Grid::paper();
        let white = [material(&grid)];
        for usual in [options(10, true), options(1000, false)] {
            check_answer(&grid, &white, &usual, MOST).unwrap();
        }
        let refused = check_answer(&grid, &white, &options(10_000, true), MOST).unwrap_err();
        assert_eq!(refused.field(), "options.top");
        assert!(refused.to_string().contains("answers may have 64 MiB"), "{refused}");
        let many = vec![white[0].clone(); 256];
        check_answer(&grid, &many, &options(10, false), MOST).unwrap();
        // In the same process there is no limit.
        check_answer(&grid, &white, &options(10_000, true), usize::MAX / 2).unwrap();
    }

    /// A design with too many slabs, shots and pixels is refused.
    #[test]
    fn too_large_design_is_refused() {
        let grid = Grid::paper();
        let usual = DesignSettings::of(Medium::new(6.0, 0.99, 0.4).unwrap());
        check_design(&grid, &DesignQuestion::new(usual.clone()).unwrap()).unwrap();
        let endless = DesignSettings {
            slab_sets: vec![vec![0.5; 32]; 256],
            shots: (1..=16).collect(),
            pixels: Some(PixelRow::new(-5.0, 5.0, 1e-4).unwrap()),
            ..usual
        };
        let refused = check_design(&grid, &DesignQuestion::new(endless).unwrap()).unwrap_err();
        assert_eq!(refused.field(), "slab_sets");
        assert!(refused.to_string().contains("8192 slabs with 16 numbers of shots"), "{refused}");
    }
}
