//! Opens the folder of a capture, which the page measures as `farmctl measure FOLDER` does.

use std::path::Path;

use anyhow::{Context, Result, bail};
use farm_lab::measurement_file::{MeasurementFile, read_measurements};
use farm_lab::session_folder::SessionFolder;
use farm_lab::set_up::{Session, SetUp};
use optics_model::fit::{FitOptions, FitSettings};
use optics_model::{Invalid, Measurement, Scene};

use super::api::{CompleteCaptureRequest, CompleteCaptureResponse, OpenCaptureResponse};
use super::note;
use super::prints::measured;
use crate::answers::{FitsReport, UsedOptions};

/// The set-up of a folder's session.
pub(super) fn set_up(folder: &Path) -> Result<SetUp> {
    SetUp::new(Some(&folder.join("session.json")), Session::default())
}

pub(super) fn open(folder: &Path) -> Result<OpenCaptureResponse> {
    let file = folder.join("measurements.csv");
    let MeasurementFile { materials, notes } =
        read_measurements(&file).with_context(|| format!("reading {}", file.display()))?;
    let set_up = set_up(folder)?;
    let materials = set_up.apply_to(materials)?;
    let known = set_up.mu_std_error();
    let settings = FitSettings { mu_std_error: known.unwrap_or_default(), ..FitSettings::default() };
    let options = FitOptions::new(FitSettings { curves: true, ..set_up.settings(settings) })?;
    let session = SessionFolder::open(folder)?;
    let (dictionary, grid) = session.dictionary()?;
    let scene = session.scene()?.filter(|_| grid.scene().is_for_all_boards());
    Ok(OpenCaptureResponse {
        materials: materials.iter().map(Into::into).collect(),
        notes: notes.into_iter().map(note).collect(),
        options: Some((&options).into()),
        mu_known: known.is_some(),
        dictionary,
        records: grid.stored_records() as u64,
        grid: Some((&grid).into()),
        board: scene.iter().flat_map(Scene::channels).map(Into::into).collect(),
    })
}

/// Writes media and report into the folder of a capture.
pub(super) fn complete(folder: &Path, request: CompleteCaptureRequest) -> Result<CompleteCaptureResponse> {
    let Some(media) = request.media else { bail!(Invalid::new("media", "nothing", "an answer is needed")) };
    let (found, Some((name, grid))) = measured(media)? else {
        bail!(Invalid::new("media.grid", "nothing", "the grid of the dictionary is needed"))
    };
    let options = FitOptions::try_from(request.options.unwrap_or_default())?;
    let materials: Vec<Measurement> =
        request.materials.into_iter().map(Measurement::try_from).collect::<Result<_, _>>()?;
    let options = options.with_mu(found.common.mu, found.common.mu_std_error.min(1.0))?;
    let assumed = set_up(folder)?.with_given(options.settings()).assumed(&materials);
    let report = FitsReport {
        fits: &found.materials,
        assumed: assumed.text(options.settings()),
        bound: false,
        scene: false,
    };
    let used = UsedOptions::new(&name, &options, &assumed);
    crate::measured::write_answer(folder, &crate::measured::data(used, &found, &[]))?;
    crate::measured::complete(&SessionFolder::open(folder)?, &found, (&name, &grid), &report)?;
    Ok(CompleteCaptureResponse {})
}
