//! BLAKE3 digests: what makes two grids, points or results the same.

use std::fmt;

use crate::grid::Grid;
use crate::job::JobSpec;
use crate::medium::TransportPoint;
use crate::profile::Record;
use crate::{PHYSICS_VERSION, canonical};

/// A 256-bit BLAKE3 digest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Digest([u8; 32]);

impl Digest {
    /// Identity of a dictionary: grid, scene and physics version.
    pub fn of_grid(grid: &Grid) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 grid");
        hasher.update(&PHYSICS_VERSION.to_le_bytes());
        hasher.update(&canonical::grid(grid));
        Self(hasher.finalize().into())
    }

    /// Digest of a job's records: every number of every profile, in order.
    pub fn of_records(records: &[Record]) -> Self {
        let mut hasher = RecordsHasher::new();
        for record in records {
            hasher.add(record.index, |bytes| record.extend_le_bytes(bytes));
        }
        hasher.finalize()
    }

    /// The same of records that lie one after the other, of `size` bytes each.
    pub(crate) fn of_packed(first: usize, records: &[u8], size: usize) -> Self {
        let mut hasher = RecordsHasher::new();
        for (index, record) in (first..).zip(records.chunks_exact(size)) {
            hasher.add(index, |bytes| bytes.extend_from_slice(record));
        }
        hasher.finalize()
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
        Self(hasher.finalize().into())
    }

    /// Identity of the sums of a divided job's blocks: that of its walks, and the albedos that they are weighted with.
    pub fn of_sums(job: &JobSpec) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 sums");
        hasher.update(&Self::of_walks(job).0);
        for albedo in job.albedo() {
            hasher.update(&albedo.to_le_bytes());
        }
        Self(hasher.finalize().into())
    }

    /// Digest of any bytes.
    pub fn of_bytes(bytes: &[u8]) -> Self {
        Self(blake3::hash(bytes).into())
    }

    /// Digest of a whole dictionary from the digests of its jobs, in order.
    pub fn of_jobs(jobs: impl IntoIterator<Item = Self>) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("farm.v1 dictionary");
        for job in jobs {
            hasher.update(&job.0);
        }
        Self(hasher.finalize().into())
    }

    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    pub fn from_hex(hex: &str) -> Option<Self> {
        blake3::Hash::from_hex(hex).ok().map(|h| Self(h.into()))
    }
}

/// Digests records in lumps: BLAKE3 is several times as fast if it is given many of its blocks of 1,024 bytes at once, in
/// powers of two.
struct RecordsHasher {
    hasher: blake3::Hasher,
    waiting: Vec<u8>,
}

impl RecordsHasher {
    const LUMP: usize = 64 << 10;

    fn new() -> Self {
        Self { hasher: blake3::Hasher::new_derive_key("farm.v1 records"), waiting: Vec::new() }
    }

    /// Adds a record's number, and what `write` appends.
    fn add(&mut self, index: usize, write: impl FnOnce(&mut Vec<u8>)) {
        self.waiting.extend((index as u64).to_le_bytes());
        write(&mut self.waiting);
        let lumps = self.waiting.len() / Self::LUMP * Self::LUMP;
        if lumps > 0 {
            self.hasher.update(&self.waiting[..lumps]);
            self.waiting.drain(..lumps);
        }
    }

    fn finalize(mut self) -> Digest {
        self.hasher.update(&self.waiting);
        Digest(self.hasher.finalize().into())
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&blake3::Hash::from_bytes(self.0).to_hex())
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
