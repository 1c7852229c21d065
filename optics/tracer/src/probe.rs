//! Runs the parts of a job on their own, for benchmarks.

use std::sync::atomic::AtomicBool;

use optics_model::controls::Controls;
use optics_model::grid::{BATCH_WALKS, CHUNK_BATCHES};
use optics_model::identity::stream_key;
use optics_model::job::JobSpec;
use optics_model::sums::Sums;

use super::exits::{Chunk, Exits};
use super::kernel::Kernel;
use super::light::Light;
use super::stack::Stack;
use super::tally::{Albedos, Tally};
use super::vertex::Vertices;
use super::walk::{self, Events};
use super::wavefront::Places;
use super::{MOST_SCATTERINGS, Stopped};

/// The first walks of a job, at most a chunk of them.
fn first_chunk(job: &JobSpec) -> Chunk {
    let walks = job.walks().get().min(CHUNK_BATCHES * BATCH_WALKS) as u32;
    Chunk { key: stream_key(job.seed(), &job.point()), index: 0, walks }
}

/// Counts the events of the first chunk, from which rates are computed.
pub fn count_events(job: &JobSpec) -> Events {
    walk::count_events(&Stack::new(job.scene(), &job.point()), first_chunk(job))
}

/// Runs the walks of the first chunk without scoring; returns the number of vertices that they pick.
pub fn run_walks(kernel: Kernel, job: &JobSpec) -> Result<usize, Stopped> {
    let chunk = first_chunk(job);
    let (mut places, mut exits) = (Places::default(), Exits::default());
    let stack = Stack::new(job.scene(), &job.point());
    let light = Light::new(&stack, false);
    kernel.run_chunk(&stack, &light, chunk, &AtomicBool::new(false), &mut places, &mut exits)?;
    Ok(exits.in_order().count())
}

/// The walks of the first chunk, ready to be scored again and again.
#[derive(Debug)]
pub struct Scoring<'a> {
    job: &'a JobSpec,
    kernel: Kernel,
    light: Light,
    albedos: Albedos,
    exits: Exits,
    vertices: Vertices,
}

impl<'a> Scoring<'a> {
    pub fn new(kernel: Kernel, job: &'a JobSpec) -> Result<Self, Stopped> {
        let chunk = first_chunk(job);
        let (mut places, mut exits) = (Places::default(), Exits::default());
        let stack = Stack::new(job.scene(), &job.point());
        let light = Light::new(&stack, job.derivatives());
        kernel.run_chunk(&stack, &light, chunk, &AtomicBool::new(false), &mut places, &mut exits)?;
        let albedos = Albedos::new(job, Controls::of_job(job), MOST_SCATTERINGS);
        Ok(Self { job, kernel, light, albedos, exits, vertices: Vertices::default() })
    }

    /// Scores the walks as one batch; returns the memory that the sums take.
    pub fn score(&mut self) -> usize {
        let mut sums = Sums::new(self.job);
        self.vertices.set(&mut self.exits, &self.light);
        let mut tally = Tally::new(self.job, &self.light, &self.albedos, self.exits.hits(), &self.vertices);
        self.kernel.score(&mut tally, &self.vertices.all);
        self.kernel.end(&mut tally, &mut sums);
        Sums::bytes(self.job)
    }
}

/// Prepares the light of a job.
pub fn prepare(job: &JobSpec) {
    Light::new(&Stack::new(job.scene(), &job.point()), job.derivatives());
}
