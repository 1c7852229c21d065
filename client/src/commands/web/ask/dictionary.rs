//! Reads grids, submits them, and simulates slabs in the scene of a dictionary.

use std::path::Path;

use anyhow::{Context, Result, anyhow};
use farm_lab::grid_file::{grid_of, named_grid, with_responses};
use farm_lab::measurement_file::plain;
use farm_lab::session_folder::SessionFolder;
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::{GetRequest, SubmitRequest};
use optics_model::grid::NoiseLevel;
use optics_model::job::JobSpec;
use optics_model::{Grid, Invalid, Medium, Scene, TransportPoint, Walks};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::task::block_in_place;

use super::{GivenFile, PageState};
use crate::commands::measurements::simulate::{JsonStyle, SimulateJson};
use crate::connection::patient;
use crate::output::DictionaryJson;
use crate::traced::traced;

/// Inputs of `farmctl submit`.
#[derive(Debug, Deserialize)]
pub(super) struct GridInputs {
    file: Option<GivenFile>,
    /// Without a file, the folder of a capture, whose dictionary is meant.
    capture: Option<String>,
    /// Without both: "lab" or "paper".
    #[serde(default)]
    built_in: String,
    /// Replaces that of the grid.
    quality: Option<String>,
    #[serde(default)]
    name: String,
}

impl GridInputs {
    fn grid(&self, state: &PageState) -> Result<Grid> {
        let grid = if let Some(file) = &self.file {
            grid_in(file)?
        } else if let Some(capture) = &self.capture {
            with_responses(SessionFolder::open(&state.captures.folder(capture)?)?.dictionary()?.1)?
        } else {
            let unknown = || Invalid::new("built_in", &self.built_in, "allowed are \"lab\" and \"paper\"");
            named_grid(&self.built_in).ok_or_else(unknown)?
        };
        match &self.quality {
            Some(quality) => Ok(grid.with_effort(NoiseLevel::from_name(quality)?)?),
            None => Ok(grid),
        }
    }
}

/// The grid of a file from a browser: it must not name other files, which would be read on this machine.
fn grid_in(file: &GivenFile) -> Result<Grid> {
    let text = plain(&file.bytes()?)
        .map_err(|_| Invalid::new("file", &file.name, "a grid file is text in UTF-8"))?;
    grid_of(&text, Path::new(&file.name), |name| {
        Scene::named(name).ok_or_else(|| {
            anyhow!(
                "scene {name:?} is in a file of its own, which a page cannot read: put it into the grid file as [scene], \
                 or use `farmctl submit`"
            )
        })
    })
}

/// Numbers of records and jobs, and bytes of all records' numbers before they are packed.
pub(super) fn size(state: &PageState, asked: &GridInputs) -> Result<Value> {
    let grid = asked.grid(state)?;
    let records = grid.stored_records();
    Ok(json!({ "records": records, "jobs": grid.job_count(), "bytes": records * grid.record_bytes() }))
}

pub(super) async fn submit(state: &PageState, asked: &GridInputs) -> Result<DictionaryJson> {
    let grid = block_in_place(|| asked.grid(state))?;
    let connection = state.farm.connection().await?;
    let request = SubmitRequest { name: asked.name.clone(), grid: Some((&grid).into()), priority: 0 };
    let mut dictionaries = connection.dictionaries();
    let asking = async { Ok(dictionaries.submit(patient(request)).await?) };
    let submitted = state.farm.answer(&connection, asking).await?.into_inner();
    Ok(DictionaryJson::from(&DictionaryStatus::try_from(submitted)?))
}

/// Inputs of `farmctl simulate` in the scene of a dictionary, by the names of its options.
#[derive(Debug, Deserialize)]
pub(super) struct SimulateInputs {
    dictionary: String,
    sigma_t: f64,
    albedo: f64,
    g: f64,
    thickness: f64,
    sample_ior: f64,
}

/// Number of walks.
const WALKS: u64 = 50_000;
/// Not that of usual dictionaries, so that the simulation is independent of their records.
const SEED: u64 = 20_171_127;

pub(super) async fn simulate(state: &PageState, asked: SimulateInputs) -> Result<SimulateJson> {
    let SimulateInputs { dictionary: name, sigma_t, albedo, g, thickness, sample_ior } = asked;
    let medium = Medium::new(sigma_t, albedo, g)?;
    let point = TransportPoint::new(sigma_t, g, thickness, sample_ior)?;
    let connection = state.farm.connection().await?;
    let mut dictionaries = connection.dictionaries();
    let asking = async { Ok(dictionaries.get(GetRequest { name }).await?) };
    let status = state.farm.answer(&connection, asking).await?.into_inner();
    let scene = DictionaryStatus::try_from(status)?.grid.scene().clone();
    let job = JobSpec::new(scene, point, vec![medium.albedo()], Walks::new(WALKS)?, SEED, false)?;
    block_in_place(|| {
        let record = traced(&job)?.pop().context("the tracer returned no record")?;
        Ok(SimulateJson::new(&JsonStyle { several: false, walks: WALKS, seed: SEED }, &job, albedo, &record))
    })
}
