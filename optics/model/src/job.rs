//! What is to be traced.

use crate::grid::{Grid, Walks};
use crate::invalid::{Invalid, Result, each};
use crate::medium::{TransportPoint, check_albedo};
use crate::profile::RecordShape;
use crate::scene::Scene;

/// All that a tracer needs to compute the records of a transport point.
#[derive(Debug, Clone, PartialEq)]
pub struct JobSpec {
    scene: Scene,
    point: TransportPoint,
    albedo: Vec<f64>,
    walks: Walks,
    seed: u64,
    derivatives: bool,
    first_record: usize,
    block: Option<u32>,
}

impl JobSpec {
    pub fn new(
        scene: Scene,
        point: TransportPoint,
        albedo: Vec<f64>,
        walks: Walks,
        seed: u64,
        derivatives: bool,
    ) -> Result<Self> {
        if albedo.is_empty() {
            return Err(Invalid::new("albedo", "0 values", "at least one is needed"));
        }
        let albedo = each("albedo", albedo, check_albedo)?;
        Ok(Self { scene, point, albedo, walks, seed, derivatives, first_record: 0, block: None })
    }

    /// The job of a grid.
    ///
    /// # Panics
    /// If the grid has no such job.
    pub fn of(grid: &Grid, job: usize) -> Self {
        Self {
            scene: grid.scene().clone(),
            point: grid.point(job),
            albedo: grid.albedo().to_vec(),
            walks: grid.walks(),
            seed: grid.seed(),
            derivatives: grid.derivatives(),
            first_record: grid.first_record(job),
            block: None,
        }
    }

    /// The same job with another number of walks.
    #[must_use]
    pub fn with_walks(self, walks: Walks) -> Self {
        Self { walks, ..self }
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

    #[test]
    fn a_job_without_albedos_is_refused() {
        let point = TransportPoint::new(1.0, 0.0, 0.5, 1.53).unwrap();
        let empty = JobSpec::new(Scene::paper(), point, vec![], Walks::PAPER, 1, false);
        assert_eq!(empty.unwrap_err().field(), "albedo");
    }
}
