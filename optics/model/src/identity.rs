//! Identifies grids, points and sums of walks by digests of everything that they depend on.

use crate::digest::Digest;
use crate::grid::{Grid, Walks};
use crate::medium::TransportPoint;
use crate::phase::PhaseShape;
use crate::scene::Scene;
use crate::{PHYSICS_VERSION, canonical};

impl Digest {
    /// Identity of a dictionary: grid, scene and physics version.
    pub fn of_grid(grid: &Grid) -> Self {
        Self::of_grid_by(PHYSICS_VERSION, &canonical::grid(grid))
    }

    /// Identity of a grid whose responses are not planned yet, with the priors and steps that they follow from.
    pub fn of_plan(grid: &Grid) -> Self {
        Self::of_grid_by(PHYSICS_VERSION, &canonical::plan(grid))
    }

    fn of_grid_by(physics_version: u32, grid: &[u8]) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 grid");
        hasher.update(&physics_version.to_le_bytes());
        hasher.update(grid);
        hasher.into()
    }

    /// The physics version under which this is the identity of a grid; None if it is the identity of another grid. Later
    /// versions are tried too, for data that a later program has written.
    pub fn physics_version_of(self, grid: &Grid) -> Option<u32> {
        /// Number of later versions that are tried.
        const TO_COME: u32 = 100;
        let grid = canonical::grid(grid);
        let mut versions = [PHYSICS_VERSION].into_iter().chain(1..PHYSICS_VERSION + TO_COME);
        versions.find(|version| Self::of_grid_by(*version, &grid) == self)
    }

    /// Identity of a set of walks: scene, transport point, number of walks, seed, derivatives, physics version.
    pub(crate) fn of_walks(
        scene: &Scene,
        point: &TransportPoint,
        walks: Walks,
        seed: u64,
        derivatives: bool,
    ) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 walks");
        hasher.update(&PHYSICS_VERSION.to_le_bytes());
        for number in [walks.get(), seed, u64::from(derivatives)] {
            hasher.update(&number.to_le_bytes());
        }
        let numbers = [point.sigma_t_per_mm(), point.g(), point.thickness_mm(), point.sample_ior()];
        hash_numbers(&mut hasher, &numbers);
        hasher.update(&canonical::scene(scene));
        hasher.into()
    }

    /// Digest of a phase function's shape.
    pub fn of_phase(phase: &PhaseShape) -> Self {
        Self::of_bytes(&canonical::phase(phase))
    }

    /// Identity of the sums of blocks of walks: that of the walks, and the albedos that they are weighted with.
    pub(crate) fn of_weighted(walks: Self, albedo: &[f64]) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 sums");
        hasher.update(walks.as_bytes());
        for albedo in albedo {
            hasher.update(&albedo.to_le_bytes());
        }
        hasher.into()
    }
}

/// Philox key of a transport point: depends on the dictionary's seed and on the slab in mean free paths. Points that have
/// these in common have the same walks, in whatever grid.
pub fn stream_key(seed: u64, point: &TransportPoint) -> [u32; 2] {
    let mut hasher = blake3::Hasher::new_derive_key("farm.v1 random streams");
    hasher.update(&seed.to_le_bytes());
    let slab = point.walked_slab();
    hasher.update(&slab.optical_thickness.to_le_bytes());
    hash_numbers(&mut hasher, &[slab.g, slab.ior]);
    let hash = hasher.finalize();
    let word = |i: usize| u32::from_le_bytes(hash.as_bytes()[4 * i..][..4].try_into().expect("4 bytes"));
    [word(0), word(1)]
}

/// Adding 0 turns −0 into 0, which is the same anisotropy.
fn hash_numbers(hasher: &mut blake3::Hasher, numbers: &[f64]) {
    for number in numbers {
        hasher.update(&(number + 0.0).to_le_bytes());
    }
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
            let axes = Axes { g: vec![0.0], thickness_mm: vec![1.0], ..Grid::paper().axes().clone() };
            Grid::new(scene, axes, Walks::new(walks).unwrap(), seed, false).unwrap()
        };
        let same = grid(1, 5000, Scene::smooth());
        let base = Digest::of_grid(&same);
        assert_eq!(base, Digest::of_grid(&grid(1, 5000, Scene::smooth())));
        assert_eq!(base.physics_version_of(&same), Some(PHYSICS_VERSION));
        for other in
            [grid(2, 5000, Scene::smooth()), grid(1, 7500, Scene::smooth()), grid(1, 5000, Scene::paper())]
        {
            assert_ne!(base, Digest::of_grid(&other));
            assert_eq!(base.physics_version_of(&other), None);
        }
        assert_eq!(Digest::from_hex(&base.to_string()), Some(base));
    }

    /// Plans of grids whose priors differ have different digests; without priors they are those of the grids.
    #[test]
    fn plans_with_other_priors_differ() {
        let axes = Grid::paper().axes().clone();
        let grid = |scene: Scene| Grid::new(scene, axes.clone(), Walks::PAPER, 1, false).unwrap();
        let lab = grid(Scene::lab());
        let fewer = grid(Scene::lab().with_priors(Scene::lab().priors()[1..].to_vec()).unwrap());
        assert_eq!(Digest::of_grid(&lab), Digest::of_grid(&fewer));
        assert_ne!(Digest::of_plan(&lab), Digest::of_plan(&fewer));
        assert_eq!(Digest::of_plan(&Grid::paper()), Digest::of_grid(&Grid::paper()));
    }

    /// Points with the same walks share a stream: of extinction and thickness, only the product counts.
    #[test]
    fn streams_depend_on_seed_depth_and_g() {
        let key = |seed, sigma_t, g, thickness| {
            stream_key(seed, &TransportPoint::new(sigma_t, g, thickness, 1.53).unwrap())
        };
        let one = key(1, 1.0, 0.0, 0.5);
        assert_eq!([key(1, 2.0, 0.0, 0.25), key(1, 1.0, -0.0, 0.5)], [one; 2]);
        for other in [key(1, 2.0, 0.0, 1.0), key(2, 1.0, 0.0, 0.5), key(1, 1.0, 0.1, 0.5)] {
            assert_ne!(other, one);
        }
    }
}
