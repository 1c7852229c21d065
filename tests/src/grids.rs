//! Provides grids, and their records as computed without a farm.

use std::sync::atomic::AtomicBool;

use optics_layers::records;
use optics_model::grid::Axes;
use optics_model::job::JobSpec;
use optics_model::scene::{Channel, Scene, Sensor};
use optics_model::{Digest, Grid, Record, Walks};
use rayon::prelude::*;

/// A grid of 12 jobs and 36 records that takes a second of one core.
pub fn small_grid() -> Grid {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 4.0, 8.0],
        albedo: vec![0.5, 0.9, 0.99],
        g: vec![0.0, 0.4],
        thickness_mm: vec![0.5, 1.0],
        sample_ior: vec![1.53],
    };
    let channels = vec![Channel::new("R", 0.985, 0.024).unwrap(), Channel::new("G", 0.972, 0.023).unwrap()];
    let scene = Scene::paper().with_channels(channels).unwrap();
    let scene = scene.with_sensor(Sensor::new(10.0, 90, 0.0).unwrap());
    Grid::new(scene, axes, Walks::new(25_000).unwrap(), 1, false).unwrap()
}

/// The grid of a file's text.
///
/// # Panics
/// If it is not a grid.
pub fn grid_of(text: &str) -> Grid {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("grid.toml");
    std::fs::write(&file, text).unwrap();
    farm_lab::grid_file::read_grid(&file).unwrap()
}

/// The records of a job of a grid, directly from the tracer.
pub fn traced(grid: &Grid, job: usize) -> Vec<Record> {
    records(&JobSpec::of(grid, job), &AtomicBool::new(false)).unwrap()
}

/// The digest of a grid's records without any faults.
pub fn undisturbed(text: &str) -> String {
    let grid = grid_of(text);
    let jobs: Vec<Digest> =
        (0..grid.job_count()).into_par_iter().map(|job| Digest::of_records(&traced(&grid, job))).collect();
    Digest::of_jobs(jobs).to_string()
}
