//! How long jobs take, and the order that follows from it.

use farm_proto::{Grid, TransportPoint};

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
