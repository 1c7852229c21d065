//! Shared by the unit tests: small grids, and rows as the store returns them.
//!
//! Whatever a test does not name is the same in all of them.

use std::sync::Arc;

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use farm_proto::status::MachineFacts;
use optics_model::grid::Axes;
use optics_model::scene::Sensor;
use optics_model::{Digest, Grid, Scene, Walks};

use crate::dispatch::Registration;
use crate::stored::{DesiredState, EndedJob, Machine, Origin, StoredDictionary};

/// A grid at g = 0 with slabs of 1 mm, over the paper's scene or one with this number of pixels.
pub(crate) fn grid(pixels: Option<u32>, sigma_t_per_mm: &[f64], albedo: &[f64], walks: u64) -> Grid {
    let scene = match pixels {
        Some(pixels) => Scene::paper().with_sensor(Sensor::new(10.0, pixels, 0.0).unwrap()),
        None => Scene::paper(),
    };
    Grid::new(scene, axes(sigma_t_per_mm, albedo), Walks::new(walks).unwrap(), 1, false).unwrap()
}

pub(crate) fn axes(sigma_t_per_mm: &[f64], albedo: &[f64]) -> Axes {
    let (sigma_t_per_mm, albedo) = (sigma_t_per_mm.to_vec(), albedo.to_vec());
    Axes { sigma_t_per_mm, albedo, g: vec![0.0], thickness_mm: vec![1.0], sample_ior: vec![1.5] }
}

pub(crate) fn name(name: &str) -> DictionaryName {
    DictionaryName::new(name).unwrap()
}

pub(crate) fn stored(id: i64, of: &str, grid: Grid) -> StoredDictionary {
    StoredDictionary {
        id: DictionaryId(id),
        name: name(of),
        grid_digest: Digest::of_grid(&grid),
        grid: Arc::new(grid),
        created_unix_ms: 0,
        priority: 0,
        desire: DesiredState::Run,
        reason: String::new(),
        owner: String::new(),
    }
}

/// A finished job of a machine, or of several.
pub(crate) fn done(job: u32, walks: Walks, records: Digest, by: Option<Origin>, reused: bool) -> EndedJob {
    EndedJob::Done { job, walks, records, by, verified: false, reused }
}

/// A process of this name on a machine.
pub(crate) fn process(machine: Machine, label: &str) -> Registration {
    let (instance, label, version) = (label.to_owned(), label.to_owned(), String::new());
    Registration { instance, machine, label, threads: 2, version, facts: MachineFacts::default() }
}
