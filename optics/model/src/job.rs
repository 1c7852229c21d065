//! Specifies jobs: everything that a tracer needs to compute records.

use std::sync::Arc;

use crate::digest::Digest;
use crate::grid::{Grid, Walks};
use crate::invalid::{Invalid, Result, each};
use crate::medium::{TransportPoint, check_albedo};
use crate::profile::RecordShape;
use crate::scene::Scene;

/// All that a tracer needs to compute the records of a transport point.
#[derive(Debug, Clone, PartialEq)]
pub struct JobSpec {
    scene: Arc<Scene>,
    point: TransportPoint,
    albedo: Vec<f64>,
    walks: Walks,
    seed: u64,
    derivatives: bool,
    identity: Digest,
    first_record: usize,
    block: Option<u32>,
}

impl JobSpec {
    pub fn new(
        scene: impl Into<Arc<Scene>>,
        point: TransportPoint,
        albedo: Vec<f64>,
        walks: Walks,
        seed: u64,
        derivatives: bool,
    ) -> Result<Self> {
        if albedo.is_empty() {
            return Err(Invalid::new("albedo", "0 values", "at least one is needed"));
        }
        let (scene, albedo) = (scene.into(), each("albedo", albedo, check_albedo)?);
        scene.phase().function(point.g())?;
        Ok(Self::checked(scene, point, albedo, walks, seed, derivatives))
    }

    fn checked(
        scene: Arc<Scene>,
        point: TransportPoint,
        albedo: Vec<f64>,
        walks: Walks,
        seed: u64,
        derivatives: bool,
    ) -> Self {
        let identity = Digest::of_walks(&scene, &point, walks, seed, derivatives);
        Self { scene, point, albedo, walks, seed, derivatives, identity, first_record: 0, block: None }
    }

    /// The job of a grid.
    ///
    /// # Panics
    /// If the grid has no such job.
    pub fn of(grid: &Grid, job: usize) -> Self {
        let (scene, albedo) = (grid.scene_of(job).clone(), grid.albedo().to_vec());
        Self::checked(scene, grid.point(job), albedo, grid.walks_of(job), grid.seed(), grid.derivatives())
            .numbered_from(grid.first_record(job))
    }

    /// This job with another number of walks.
    #[must_use]
    pub fn with_walks(self, walks: Walks) -> Self {
        if walks == self.walks {
            return self;
        }
        let identity = Digest::of_walks(&self.scene, &self.point, walks, self.seed, self.derivatives);
        Self { walks, identity, ..self }
    }

    /// One block of a divided job.
    pub fn with_block(self, block: u32) -> Result<Self> {
        let blocks = self.walks.blocks();
        if block >= blocks {
            return Err(Invalid::new("block", block, format!("the job has blocks 0 to {}", blocks - 1)));
        }
        Ok(Self { block: Some(block), ..self })
    }

    /// Numbers the job's records from `first_record` on.
    #[must_use]
    pub fn numbered_from(self, first_record: usize) -> Self {
        Self { first_record, ..self }
    }

    /// Digest of everything that the job's records depend on, albedos and numbers apart: records with the same identity
    /// and albedo are equal.
    pub fn identity(&self) -> Digest {
        self.identity
    }

    /// Digest of everything that the sums of the job's blocks depend on.
    pub fn sums_identity(&self) -> Digest {
        Digest::of_weighted(self.identity, &self.albedo)
    }

    /// Whether one set of walks serves both jobs: they differ at most in the length of a mean free path.
    pub fn shares_walks_with(&self, other: &Self) -> bool {
        let effort = |job: &Self| (job.walks, job.seed, job.derivatives, job.block);
        self.point.walked_slab() == other.point.walked_slab()
            && effort(self) == effort(other)
            && self.albedo == other.albedo
            && (Arc::ptr_eq(&self.scene, &other.scene) || self.scene == other.scene)
    }

    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    pub fn point(&self) -> TransportPoint {
        self.point
    }

    pub fn albedo(&self) -> &[f64] {
        &self.albedo
    }

    pub fn walks(&self) -> Walks {
        self.walks
    }

    pub fn seed(&self) -> u64 {
        self.seed
    }

    pub fn derivatives(&self) -> bool {
        self.derivatives
    }

    pub fn first_record(&self) -> usize {
        self.first_record
    }

    /// The block to trace, if the job is divided.
    pub fn block(&self) -> Option<u32> {
        self.block
    }
}

impl RecordShape {
    pub fn of_job(job: &JobSpec) -> Self {
        Self {
            channels: job.scene.channels().len(),
            pixels: job.scene.sensor().pixels(),
            derivatives: job.derivatives,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Jobs share walks if only the mean free path differs.
    #[test]
    fn only_mean_free_path_may_differ() {
        let job = |[sigma_t, g, thickness]: [f64; 3], seed| {
            let point = TransportPoint::new(sigma_t, g, thickness, 1.53).unwrap();
            JobSpec::new(Scene::paper(), point, vec![0.5], Walks::PAPER, seed, false).unwrap()
        };
        let one = job([2.0, 0.4, 0.5], 1);
        assert!(one.shares_walks_with(&job([1.0, 0.4, 1.0], 1)));
        // 0.3 and 0.30000000000000004.
        assert!(job([0.3, 0.4, 1.0], 1).shares_walks_with(&job([3.0, 0.4, 0.1], 1)));
        for other in [job([2.0, 0.4, 1.0], 1), job([2.0, 0.5, 0.5], 1), job([2.0, 0.4, 0.5], 2)] {
            assert!(!one.shares_walks_with(&other), "{other:?}");
        }
    }

    #[test]
    fn job_without_albedos_is_refused() {
        let point = TransportPoint::new(1.0, 0.0, 0.5, 1.53).unwrap();
        let empty = JobSpec::new(Scene::paper(), point, vec![], Walks::PAPER, 1, false);
        assert_eq!(empty.unwrap_err().field(), "albedo");
    }
}
