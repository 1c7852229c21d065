//! What makes two grids, points or sums of walks the same: digests of all that they depend on.

use crate::digest::Digest;
use crate::grid::Grid;
use crate::job::JobSpec;
use crate::medium::TransportPoint;
use crate::{PHYSICS_VERSION, canonical};

impl Digest {
    /// Identity of a dictionary: grid, scene and physics version.
    pub fn of_grid(grid: &Grid) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 grid");
        hasher.update(&PHYSICS_VERSION.to_le_bytes());
        hasher.update(&canonical::grid(grid));
        hasher.into()
    }

    /// Identity of a set of walks: scene, transport point, number of walks, seed, derivatives, physics version.
    pub fn of_walks(job: &JobSpec) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 walks");
        hasher.update(&PHYSICS_VERSION.to_le_bytes());
        for number in [job.walks().get(), job.seed(), u64::from(job.derivatives())] {
            hasher.update(&number.to_le_bytes());
        }
        for number in numbers_of(&job.point()) {
            hasher.update(&number.to_le_bytes());
        }
        hasher.update(&canonical::scene(job.scene()));
        hasher.into()
    }

    /// Identity of the sums of a divided job's blocks: that of its walks, and the albedos that they are weighted with.
    pub fn of_sums(job: &JobSpec) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 sums");
        hasher.update(Self::of_walks(job).as_bytes());
        for albedo in job.albedo() {
            hasher.update(&albedo.to_le_bytes());
        }
        hasher.into()
    }
}

impl JobSpec {
    /// What the job's records depend on, albedos and numbers apart: those with the same identity and albedo are equal.
    pub fn identity(&self) -> Digest {
        Digest::of_walks(self)
    }
}

/// Philox key of a transport point: depends on the dictionary's seed and on the point's parameters,
/// not on its place in a grid, so that the same point in another grid gets the same walks.
pub fn stream_key(seed: u64, point: &TransportPoint) -> [u32; 2] {
    let mut hasher = blake3::Hasher::new_derive_key("farm.v1 random streams");
    hasher.update(&seed.to_le_bytes());
    for number in numbers_of(point) {
        hasher.update(&number.to_le_bytes());
    }
    let hash = hasher.finalize();
    let word = |i: usize| u32::from_le_bytes(hash.as_bytes()[4 * i..][..4].try_into().expect("4 bytes"));
    [word(0), word(1)]
}

fn numbers_of(point: &TransportPoint) -> [f64; 4] {
    // Adding 0 turns -0 into 0, which is the same anisotropy.
    [point.sigma_t_per_mm(), point.g(), point.thickness_mm(), point.sample_ior()].map(|v| v + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Walks;
    use crate::grid::Axes;
    use crate::scene::Scene;

    #[test]
    fn grids_that_differ_anywhere_have_different_digests() {
        let grid = |seed, walks, scene| {
            let axes = Axes {
                sigma_t_per_mm: vec![1.0],
                albedo: vec![0.5],
                g: vec![0.0],
                thickness_mm: vec![1.0],
                sample_ior: vec![1.5],
            };
            Grid::new(scene, axes, Walks::new(walks).unwrap(), seed, false).unwrap()
        };
        let base = Digest::of_grid(&grid(1, 5000, Scene::smooth()));
        assert_eq!(base, Digest::of_grid(&grid(1, 5000, Scene::smooth())));
        assert_ne!(base, Digest::of_grid(&grid(2, 5000, Scene::smooth())));
        assert_ne!(base, Digest::of_grid(&grid(1, 7500, Scene::smooth())));
        assert_ne!(base, Digest::of_grid(&grid(1, 5000, Scene::paper())));
        assert_eq!(Digest::from_hex(&base.to_string()), Some(base));
    }

    #[test]
    fn streams_depend_on_seed_and_point() {
        let point = |g| TransportPoint::new(1.0, g, 0.5, 1.53).unwrap();
        assert_eq!(stream_key(1, &point(0.0)), stream_key(1, &point(-0.0)));
        assert_ne!(stream_key(1, &point(0.0)), stream_key(2, &point(0.0)));
        assert_ne!(stream_key(1, &point(0.0)), stream_key(1, &point(0.1)));
    }
}
