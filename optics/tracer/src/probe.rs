//! What benchmarks need to reach: the parts of a job on their own.

use std::sync::atomic::AtomicBool;

use optics_model::grid::BATCH_WALKS;
use optics_model::identity::stream_key;
use optics_model::job::JobSpec;
use optics_model::sums::Sums;

use super::exits::{Chunk, Exits};
use super::kernel::Kernel;
use super::powers::AlbedoPowers;
use super::stack::Stack;
use super::tally::Tally;
use super::walk::{self, Events};
use super::{CHUNK_BATCHES, Stopped};

/// The first walks of a job, at most a chunk of them.
fn first_chunk(job: &JobSpec) -> Chunk {
    let walks = job.walks().get().min(CHUNK_BATCHES * BATCH_WALKS) as u32;
    Chunk { key: stream_key(job.seed(), &job.point()), index: 0, walks }
}

/// Counts the events of the first chunk, one by one: what rates are made of.
pub fn count_events(job: &JobSpec) -> Events {
    walk::count_events(&Stack::new(job.scene(), &job.point()), first_chunk(job))
}

/// The walks of the first chunk alone, without scoring; returns how many left into the ring.
pub fn run_walks(kernel: Kernel, job: &JobSpec) -> Result<usize, Stopped> {
    let chunk = first_chunk(job);
    let mut exits = Exits::default();
    let stack = Stack::new(job.scene(), &job.point());
    kernel.run_chunk(&stack, chunk, &AtomicBool::new(false), &mut exits)?;
    Ok(exits.in_order(chunk.walks).count())
}

/// The walks of the first chunk, ready to be scored again and again.
#[derive(Debug)]
pub struct Scoring<'a> {
    job: &'a JobSpec,
    kernel: Kernel,
    powers: AlbedoPowers,
    exits: Exits,
}

impl<'a> Scoring<'a> {
    pub fn new(kernel: Kernel, job: &'a JobSpec) -> Result<Self, Stopped> {
        let mut exits = Exits::default();
        let stack = Stack::new(job.scene(), &job.point());
        kernel.run_chunk(&stack, first_chunk(job), &AtomicBool::new(false), &mut exits)?;
        Ok(Self { job, kernel, powers: AlbedoPowers::new(job.albedo()), exits })
    }

    /// Scores the walks as one batch; returns the memory that the sums take.
    pub fn score(&mut self) -> usize {
        let mut partial = Sums::new(self.job);
        let mut tally = Tally::new(self.job, &self.powers);
        let exits = self.exits.in_order(first_chunk(self.job).walks);
        self.kernel.score(&mut tally, exits, &mut partial);
        Sums::bytes(self.job)
    }
}
