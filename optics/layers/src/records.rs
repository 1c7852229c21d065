//! The records of jobs: walks, corrected by exact levels.

use std::sync::atomic::AtomicBool;

use optics_model::controls::Controls;
use optics_model::job::JobSpec;
use optics_model::profile::Record;
use optics_model::scene::Channel;
use optics_model::sums::Sums;
use optics_tracer::{Stopped, trace_set, trace_set_block};
use rayon::prelude::*;

use crate::ladder::Ladder;
use crate::print::Print;

/// The records of a job, one per albedo, on the current rayon pool. Checks `stop` continually.
pub fn records(job: &JobSpec, stop: &AtomicBool) -> Result<Vec<Record>, Stopped> {
    Ok(records_of_set(std::slice::from_ref(job), stop)?.pop().unwrap_or_default())
}

/// The records of jobs that share their walks, in the time of one and their scoring: for each those of [`records`].
///
/// # Panics
/// If two of the jobs do not share their walks ([`JobSpec::shares_walks_with`]).
pub fn records_of_set(jobs: &[JobSpec], stop: &AtomicBool) -> Result<Vec<Vec<Record>>, Stopped> {
    let sums = with_levels(trace_set(jobs, stop)?, jobs);
    Ok(sums.into_iter().zip(jobs).map(|(sums, job)| sums.into_records(job)).collect())
}

/// One block of jobs that share their walks. The sums of all blocks, merged in their order, make the jobs' records.
///
/// # Panics
/// If the jobs have no such block, or do not share their walks.
pub fn block_of_set(jobs: &[JobSpec], block: u32, stop: &AtomicBool) -> Result<Vec<Sums>, Stopped> {
    Ok(with_levels(trace_set_block(jobs, block, stop)?, jobs))
}

/// Jobs that share their walks have the same levels.
fn with_levels(mut sums: Vec<Sums>, jobs: &[JobSpec]) -> Vec<Sums> {
    let levels = jobs.first().map(levels).unwrap_or_default();
    for sums in &mut sums {
        sums.exact.clone_from(&levels);
    }
    sums
}

/// Exact radiance factors over uniform bases: `[light, dark][channel][control]`.
fn levels(job: &JobSpec) -> Vec<f64> {
    let (scene, point) = (job.scene(), job.point());
    let controls = Controls::of_job(job);
    if controls.is_empty() {
        return Vec::new();
    }
    let peak = scene.phase().function_near(point.g()).peak_width();
    let print = Print::remembered(scene, point.sample_ior() + scene.sample_ior_offset(), peak);
    // In the precision of the walks, in which jobs that share them have the same thickness.
    let depth = f64::from(point.walked_slab().optical_thickness);
    let phase = (scene.phase(), point.g());
    let ladder = |albedo: &f64| Ladder::remembered(&print, phase, *albedo, depth);
    let ladders: Vec<_> = controls.albedos().par_iter().map(ladder).collect();
    let rows =
        [Channel::rho_light, Channel::rho_dark].into_iter().flat_map(|rho| scene.channels().iter().map(rho));
    rows.flat_map(|rho| ladders.iter().map(move |ladder| ladder.level(depth, rho))).collect()
}
