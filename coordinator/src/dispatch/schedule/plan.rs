//! Plans the jobs of a grid: estimates their costs, and orders them by cost.

use std::collections::BTreeSet;

use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, Invalid, TransportPoint, Walks};

use super::job::Job;

/// The jobs and parts that the coordinator holds for a dictionary's grid, with nothing done.
#[derive(Debug)]
pub struct Plan {
    pub(super) jobs: Vec<Job>,
    /// Parts that wait, as (rank, job, part).
    pub(super) pending: BTreeSet<(u32, u32, u32)>,
    /// The reason why the grid is too large to be worked on.
    pub(super) too_large: Option<Invalid>,
}

impl Plan {
    /// Number of jobs and waiting parts.
    pub fn entries(&self) -> usize {
        self.jobs.len() + self.pending.len()
    }

    /// Plans a grid. If it is too large, the plan holds its jobs and none of their parts.
    pub fn new(grid: &Grid) -> Self {
        let too_large = grid.check_parts().err();
        let mut jobs: Vec<Job> = (0..grid.job_count())
            .map(|job| {
                let walks = grid.walks_of(job);
                Job::new(walks, parts_of(walks, too_large.as_ref()), cost_per_walk(&grid.point(job)))
            })
            .collect();
        let mut rank = 0;
        // The longest come first, so that none of them is left over at the end.
        for set in grid.walk_sets() {
            let places = [rank, rank + set.len() as u32];
            for (job, rank) in set.into_iter().zip(rank..) {
                (jobs[job as usize].rank, jobs[job as usize].set) = (rank, places);
            }
            rank = places[1];
        }
        let each = jobs.iter().zip(0..);
        let pending = each.flat_map(|(job, index)| job.open_parts().map(move |part| (job.rank, index, part)));
        Self { pending: pending.collect(), jobs, too_large }
    }
}

/// A digest of everything besides the transport point that the walks of a grid depend on. None if the grid has a target
/// error: then the final number of walks of a job is not known in advance.
pub(super) fn family(grid: &Grid) -> Option<Digest> {
    if grid.quality().is_some() {
        return None;
    }
    // Any point will do, as long as it is the same for all.
    let point = TransportPoint::new(1.0, 0.0, 1.0, 1.5).ok()?;
    let (scene, albedo) = (grid.shared_scene().clone(), vec![0.5]);
    // With a level of noise the number of walks differs from point to point: jobs are compared by their number, too.
    let walks = grid.effort().walks(&point);
    let job = JobSpec::new(scene, point, albedo, walks, grid.seed(), grid.derivatives()).ok()?;
    Some(job.identity())
}

/// Parts of a job that are worked on.
pub(super) fn parts_of(walks: Walks, too_large: Option<&Invalid>) -> u32 {
    if too_large.is_some() { 0 } else { walks.blocks() }
}

/// Expected time of a walk, in scatterings.
///
/// The mean length of a walk in the slab is proportional to its thickness, whatever σ_t and g, so the number of
/// scatterings is proportional to the optical thickness: about 4 n² = 9.4 per unit over a bright base. Some 18 interface
/// crossings and the scoring add as much time as 50 (g 0.8) to 150 (g 0) scatterings, according to the times of whole
/// points in `docs/measured.md`.
pub(super) fn cost_per_walk(point: &TransportPoint) -> f64 {
    80.0 + 9.4 * point.optical_thickness()
}
