//! The jobs of a grid: how long they take, and the order that follows from it.

use std::collections::BTreeSet;

use optics_model::{Grid, Invalid, TransportPoint, Walks};

use super::job::Job;

/// All that a dictionary's grid makes the coordinator hold, with nothing done.
#[derive(Debug)]
pub struct Plan {
    pub(super) jobs: Vec<Job>,
    /// Parts that wait, as (rank, job, part).
    pub(super) pending: BTreeSet<(u32, u32, u32)>,
    /// Why the grid is too large to be worked on.
    pub(super) too_large: Option<Invalid>,
}

impl Plan {
    /// Of a grid that is too large only the jobs are held, and none of their parts.
    pub fn new(grid: &Grid) -> Self {
        let too_large = grid.check_parts().err();
        let parts = parts_of(grid.walks(), too_large.as_ref());
        let mut jobs: Vec<Job> = (0..grid.job_count())
            .map(|job| Job::new(grid.walks(), parts, cost_per_walk(&grid.point(job))))
            .collect();
        for (rank, job) in longest_first(grid).into_iter().enumerate() {
            jobs[job as usize].rank = rank as u32;
        }
        let each = jobs.iter().zip(0..);
        let pending = each.flat_map(|(job, index)| job.open_parts().map(move |part| (job.rank, index, part)));
        Self { pending: pending.collect(), jobs, too_large }
    }
}

/// Parts of a job that are worked on.
pub(super) fn parts_of(walks: Walks, too_large: Option<&Invalid>) -> u32 {
    if too_large.is_some() { 0 } else { walks.blocks() }
}

/// Expected time of a walk, in scatterings.
///
/// The mean length of a walk in the slab is proportional to its thickness, whatever σ_t and g, so the number of
/// scatterings is proportional to the optical thickness: about 4 n² = 9.4 per unit over a bright base. To that come
/// some 18 interface crossings, which take the vector kernel as long as 80 scatterings.
pub(super) fn cost_per_walk(point: &TransportPoint) -> f64 {
    80.0 + 9.4 * point.optical_thickness()
}

/// Jobs of a grid, the costliest first, so that none of the long ones is left over at the end.
pub(super) fn longest_first(grid: &Grid) -> Vec<u32> {
    let mut jobs: Vec<(f64, u32)> =
        (0..grid.job_count() as u32).map(|job| (cost_per_walk(&grid.point(job as usize)), job)).collect();
    jobs.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    jobs.into_iter().map(|(_, job)| job).collect()
}
