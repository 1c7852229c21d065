//! The Monte Carlo tracer: computes the records of a job.
//!
//! Three exact facts make one set of walks serve every pixel, albedo and channel of a transport point: only the
//! base's reflectance depends on x (so a walk is shifted, not repeated), the albedo factors out as α^n, and the
//! channels differ in the base alone. See docs/design/estimator.md.
//!
//! The result is a function of the job alone. Walks draw from counter-based streams; batches are grouped into
//! chunks of a fixed size, chunks into blocks, and sums merged in their order, whichever thread or machine finished
//! first.
//!
//! `docs/glossary.md` explains the terms.

mod bare_board;
mod exits;
pub mod face;
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
mod vertex;
mod walk;
mod wavefront;

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

use optics_model::controls::Controls;
use optics_model::grid::{BATCH_WALKS, BLOCK_BATCHES, CHUNK_BATCHES};
use optics_model::identity::stream_key;
use optics_model::job::JobSpec;
use optics_model::profile::Record;
use optics_model::sums::Sums;
use rayon::prelude::*;

pub use bare_board::{BareBoard, SeenBase};
use exits::{Chunk, Exits, Offset};
pub use kernel::Kernel;
use light::Light;
use stack::Stack;
use tally::{Albedos, Tally};
use vertex::Vertices;
use wavefront::Places;

/// More scatterings than walks can have: roulette ends them long before.
const MOST_SCATTERINGS: u32 = 1 << 24;

/// Memory of the sums that may wait to be merged, per job.
const WAVE_BYTES: usize = 64 << 20;

/// Tracing was stopped from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("tracing was stopped before the end")]
pub struct Stopped;

/// Traces a job on the current rayon pool with the kernel of this process ([`Kernel::chosen`]) and returns one record
/// per albedo, by walks alone. Checks `stop` continually.
pub fn trace(job: &JobSpec, stop: &AtomicBool) -> Result<Vec<Record>, Stopped> {
    trace_with(Kernel::chosen(), job, stop)
}

/// Traces a job with the given kernel: the records of all kernels are the same to the last bit.
pub fn trace_with(kernel: Kernel, job: &JobSpec, stop: &AtomicBool) -> Result<Vec<Record>, Stopped> {
    let sums = set_sums(kernel, std::slice::from_ref(job), stop, Sums::of_walks_alone)?.pop();
    Ok(sums.map_or_else(Vec::new, |sums| sums.into_records(job)))
}

/// Traces jobs that share their walks in the time of one and their scoring: for each the sums over all of its walks, in
/// which exact levels are to be set.
///
/// # Panics
/// If two of the jobs do not share their walks ([`JobSpec::shares_walks_with`]).
pub fn trace_set(jobs: &[JobSpec], stop: &AtomicBool) -> Result<Vec<Sums>, Stopped> {
    set_sums(Kernel::chosen(), jobs, stop, Sums::new)
}

fn set_sums(
    kernel: Kernel,
    jobs: &[JobSpec],
    stop: &AtomicBool,
    empty: fn(&JobSpec) -> Sums,
) -> Result<Vec<Sums>, Stopped> {
    let Some(tracer) = Tracer::new(kernel, jobs, stop, empty) else { return Ok(Vec::new()) };
    let mut totals: Vec<_> = jobs.iter().map(empty).collect();
    for block in 0..jobs[0].walks().blocks() {
        merge(&mut totals, &tracer.block(block)?);
    }
    Ok(totals)
}

/// Traces one block of jobs that share their walks, like [`trace_set`]. The sums of all blocks, merged in their order, are
/// those of the job.
///
/// # Panics
/// If the jobs have no such block, or do not share their walks.
pub fn trace_set_block(jobs: &[JobSpec], block: u32, stop: &AtomicBool) -> Result<Vec<Sums>, Stopped> {
    assert!(jobs.iter().all(|job| block < job.walks().blocks()), "block {block} is not of these jobs");
    let tracer = Tracer::new(Kernel::chosen(), jobs, stop, Sums::new);
    tracer.map_or_else(|| Ok(Vec::new()), |tracer| tracer.block(block))
}

fn merge(totals: &mut [Sums], sums: &[Sums]) {
    totals.iter_mut().zip(sums).for_each(|(total, sum)| total.merge(sum));
}

/// Memory for the walks of a chunk and their vertices.
#[derive(Debug, Default)]
struct Memory {
    places: Places,
    exits: Exits,
    vertices: Vertices,
}

/// Walks, and the jobs that share them.
struct Tracer<'a> {
    kernel: Kernel,
    jobs: &'a [JobSpec],
    stack: Stack,
    light: Light,
    albedos: Albedos,
    key: [u32; 2],
    stop: &'a AtomicBool,
    empty: fn(&JobSpec) -> Sums,
}

impl<'a> Tracer<'a> {
    /// None without jobs.
    fn new(
        kernel: Kernel,
        jobs: &'a [JobSpec],
        stop: &'a AtomicBool,
        empty: fn(&JobSpec) -> Sums,
    ) -> Option<Self> {
        let job = jobs.first()?;
        for other in jobs {
            assert!(job.shares_walks_with(other), "{:?} has walks of its own", other.point());
        }
        let stack = Stack::new(job.scene(), &job.point());
        let controls = if empty(job).is_controlled() { Controls::of_job(job) } else { Controls::default() };
        Some(Self {
            kernel,
            jobs,
            light: kernel.light(&stack, job.derivatives()),
            stack,
            albedos: Albedos::new(job, controls, MOST_SCATTERINGS),
            key: stream_key(job.seed(), &job.point()),
            stop,
            empty,
        })
    }

    /// Every job's sums of a block, chunk after chunk.
    fn block(&self, block: u32) -> Result<Vec<Sums>, Stopped> {
        const CHUNKS: u64 = BLOCK_BATCHES / CHUNK_BATCHES;
        let batches = self.jobs[0].walks().batches();
        let chunks =
            u64::from(block) * CHUNKS..((u64::from(block) + 1) * CHUNKS).min(batches.div_ceil(CHUNK_BATCHES));
        let mut totals: Vec<_> = self.jobs.iter().map(self.empty).collect();
        let bytes: usize = self.jobs.iter().map(Sums::bytes).sum();
        // Waves bound the memory: the sums of one wave at a time wait to be merged.
        let most = 2 * rayon::current_num_threads().max(1);
        let wave = (WAVE_BYTES / bytes).clamp(1, most) as u64;
        for first in chunks.clone().step_by(wave as usize) {
            let wave = first..(first + wave).min(chunks.end);
            let sums: Vec<Result<Vec<Sums>, Stopped>> = wave
                .into_par_iter()
                .map(|chunk| self.chunk(chunk, CHUNK_BATCHES.min(batches - chunk * CHUNK_BATCHES)))
                .collect();
            for sums in sums {
                merge(&mut totals, &sums?);
            }
        }
        Ok(totals)
    }

    fn chunk(&self, index: u64, batches: u64) -> Result<Vec<Sums>, Stopped> {
        // A thread traces one chunk after another: releasing memory and allocating it again costs more than filling it.
        thread_local!(static MEMORY: Cell<Memory> = Cell::default());
        let mut memory = MEMORY.take();
        let sums = self.chunk_in(&mut memory, index, batches);
        MEMORY.set(memory);
        sums
    }

    fn chunk_in(&self, memory: &mut Memory, index: u64, batches: u64) -> Result<Vec<Sums>, Stopped> {
        let Memory { places, exits, vertices } = memory;
        let chunk = Chunk { key: self.key, index, walks: (batches * BATCH_WALKS) as u32 };
        self.kernel.run_chunk(&self.stack, &self.light, chunk, self.stop, places, exits)?;
        vertices.set(exits, &self.light);
        self.jobs.iter().map(|job| self.score(job, exits.hits(), vertices, batches)).collect()
    }

    /// A job's sums of a chunk's vertices.
    fn score(
        &self,
        job: &JobSpec,
        hits: &[Offset],
        vertices: &Vertices,
        batches: u64,
    ) -> Result<Sums, Stopped> {
        let mut tally = Tally::new(job, &self.light, &self.albedos, hits, vertices);
        let mut rest = &vertices.all[..];
        for batch in 1..=batches {
            if self.stop.load(Ordering::Relaxed) {
                return Err(Stopped);
            }
            let end = (batch * BATCH_WALKS) as u32;
            let of_batch;
            (of_batch, rest) = rest.split_at(rest.partition_point(|vertex| vertex.walk < end));
            self.kernel.score(&mut tally, of_batch);
        }
        let mut sums = (self.empty)(job);
        self.kernel.end(&mut tally, &mut sums);
        Ok(sums)
    }
}

#[cfg(test)]
mod tests;
