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

#[cfg(test)]
mod tests {
    use optics_model::scene::{Layer, RingLight, Scene, Sensor};
    use optics_model::{TransportPoint, Walks};

    use super::*;

    static RUN: AtomicBool = AtomicBool::new(false);

    fn job(scene: &Scene, g: f64, albedo: f64, walks: u64) -> JobSpec {
        let point = TransportPoint::new(4.0, g, 0.5, 1.53).unwrap();
        let scene = scene.clone().with_sensor(Sensor::new(16.0, 32, 0.0).unwrap());
        JobSpec::new(scene, point, vec![albedo], Walks::new(walks).unwrap(), 3, false).unwrap()
    }

    /// Values and standard errors of the first channel.
    fn pixels(records: Result<Vec<Record>, Stopped>) -> Vec<(f64, f64)> {
        let record = records.unwrap().remove(0);
        let estimate = &record.profiles[0].radiance_factor;
        let pairs = estimate.values().iter().zip(estimate.std_errors());
        pairs.map(|(value, error)| (f64::from(*value), f64::from(*error))).collect()
    }

    /// In every pixel records agree with many more walks alone, and far from the edge with little noise. The narrow ring and
    /// the very rough face need more rays than the built-in scenes.
    #[test]
    fn records_agree_with_walks_alone() {
        let ring = RingLight::new(44.9, 45.1).unwrap();
        let bare = vec![Layer::sample("sample", 0.4).unwrap()];
        let paper = Scene::paper();
        let bare = Scene::new(bare, paper.channels().to_vec(), paper.light(), paper.sensor(), true).unwrap();
        for (scene, g) in [(Scene::smooth(), 0.4), (paper.clone().with_light(ring), 0.8), (bare, 0.0)] {
            for albedo in [0.84, 0.995] {
                let found = pixels(records(&job(&scene, g, albedo, 4000), &RUN));
                let truth = pixels(optics_tracer::trace(&job(&scene, g, albedo, 1_000_000), &RUN));
                for ((found, error), (truth, of_truth)) in found.iter().zip(&truth) {
                    let room = 5.0 * libm::hypot(*error, *of_truth);
                    assert!(
                        (found - truth).abs() < room,
                        "{g} {albedo}: {found} ± {error}, {truth} ± {of_truth}"
                    );
                }
                for end in [0, found.len() - 1] {
                    let (value, error) = found[end];
                    assert!(error < 3e-3 * value, "{g} {albedo}: {value} ± {error}");
                }
            }
        }
    }

    /// Under a peak that the solver does not resolve, records are those of the walks.
    #[test]
    fn narrow_peaks_leave_the_walks_alone() {
        let job = job(&Scene::smooth(), 0.98, 0.9, 2000);
        assert_eq!(records(&job, &RUN), optics_tracer::trace(&job, &RUN));
    }
}
