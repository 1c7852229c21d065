//! The Monte Carlo tracer: from a job to its records.
//!
//! Three exact facts make one set of walks serve every pixel, albedo and channel of a transport point: only the
//! base's reflectance depends on x (so a walk is shifted, not repeated), the albedo factors out as α^n, and the
//! channels differ in the base alone. See docs/design/estimator.md.
//!
//! The result is a function of the job alone. Walks draw from counter-based streams; batches are grouped into
//! chunks of a fixed size, chunks into blocks, and sums merged in their order, whichever thread or machine was done
//! first.

mod bare_board;
mod exits;
mod fresnel;
mod kernel;
mod light;
mod math;
mod microfacet;
mod phase;
mod pick;
#[doc(hidden)]
pub mod probe;
mod rng;
mod scatterings;
mod stack;
mod tally;
#[cfg(test)]
mod testing;
mod walk;
mod wavefront;

use std::sync::atomic::{AtomicBool, Ordering};

use optics_model::grid::{BATCH_WALKS, BLOCK_BATCHES, CHUNK_BATCHES};
use optics_model::identity::stream_key;
use optics_model::job::JobSpec;
use optics_model::profile::Record;
use optics_model::sums::Sums;
use rayon::prelude::*;

pub use bare_board::BareBoard;
use exits::{Chunk, Exits};
pub use kernel::Kernel;
use light::Light;
use scatterings::NodePowers;
use stack::Stack;
use tally::Tally;

/// More scatterings than walks can have: roulette ends them long before.
const MOST_SCATTERINGS: u32 = 1 << 24;

/// Memory of the sums that may wait to be merged, per job.
const WAVE_BYTES: usize = 64 << 20;

/// Tracing was stopped from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("tracing was stopped before the end")]
pub struct Stopped;

/// Traces a job on the current rayon pool with the fastest kernel of this machine and returns one record per albedo.
/// Looks at `stop` all the time.
pub fn trace(job: &JobSpec, stop: &AtomicBool) -> Result<Vec<Record>, Stopped> {
    trace_with(Kernel::fastest(), job, stop)
}

/// Traces a job with a kernel of one's choice: the records are the same to the last bit, whichever it is.
pub fn trace_with(kernel: Kernel, job: &JobSpec, stop: &AtomicBool) -> Result<Vec<Record>, Stopped> {
    let tracer = Tracer::new(kernel, job, stop);
    let mut total = Sums::new(job);
    for block in 0..job.walks().blocks() {
        total.merge(&tracer.block(block)?);
    }
    Ok(total.into_records(job))
}

/// Traces one block of a job's walks. The sums of all blocks, merged in their order, make the job's records.
///
/// # Panics
/// If the job has no such block.
pub fn trace_block(job: &JobSpec, block: u32, stop: &AtomicBool) -> Result<Sums, Stopped> {
    assert!(block < job.walks().blocks(), "block {block} is not of this job");
    Tracer::new(Kernel::fastest(), job, stop).block(block)
}

struct Tracer<'a> {
    kernel: Kernel,
    job: &'a JobSpec,
    stack: Stack,
    light: Light,
    powers: NodePowers,
    key: [u32; 2],
    stop: &'a AtomicBool,
}

impl<'a> Tracer<'a> {
    fn new(kernel: Kernel, job: &'a JobSpec, stop: &'a AtomicBool) -> Self {
        let stack = Stack::new(job.scene(), &job.point());
        Self {
            kernel,
            job,
            light: Light::new(&stack, job.derivatives()),
            stack,
            powers: NodePowers::new(job.albedo(), MOST_SCATTERINGS),
            key: stream_key(job.seed(), &job.point()),
            stop,
        }
    }

    /// Sums of a block, chunk after chunk.
    fn block(&self, block: u32) -> Result<Sums, Stopped> {
        const CHUNKS: u64 = BLOCK_BATCHES / CHUNK_BATCHES;
        let batches = self.job.walks().batches();
        let chunks =
            u64::from(block) * CHUNKS..((u64::from(block) + 1) * CHUNKS).min(batches.div_ceil(CHUNK_BATCHES));
        let mut total = Sums::new(self.job);
        // Waves bound the memory: sums of one wave at a time wait for their turn.
        let most = 2 * rayon::current_num_threads().max(1);
        let wave = (WAVE_BYTES / Sums::bytes(self.job)).clamp(1, most) as u64;
        for first in chunks.clone().step_by(wave as usize) {
            let wave = first..(first + wave).min(chunks.end);
            let sums: Vec<Result<Sums, Stopped>> = wave
                .into_par_iter()
                .map(|chunk| self.chunk(chunk, CHUNK_BATCHES.min(batches - chunk * CHUNK_BATCHES)))
                .collect();
            for sum in sums {
                total.merge(&sum?);
            }
        }
        Ok(total)
    }

    fn chunk(&self, index: u64, batches: u64) -> Result<Sums, Stopped> {
        let walks = (batches * BATCH_WALKS) as u32;
        let chunk = Chunk { key: self.key, index, walks };
        let mut exits = Exits::new(walks);
        self.kernel.run_chunk(&self.stack, &self.light, chunk, self.stop, &mut exits)?;
        let mut tally = Tally::new(self.job, &self.light, &self.powers, exits.most_scatterings());
        let mut exits = exits.in_order().peekable();
        for batch in 1..=batches {
            if self.stop.load(Ordering::Relaxed) {
                return Err(Stopped);
            }
            let end = (batch * BATCH_WALKS) as u32;
            let exits = std::iter::from_fn(|| exits.next_if(|exit| exit.pick.walk < end));
            self.kernel.score(&mut tally, exits);
        }
        let mut sums = Sums::new(self.job);
        self.kernel.end(&mut tally, &mut sums);
        Ok(sums)
    }
}
