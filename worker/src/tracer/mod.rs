//! The Monte Carlo tracer: from a job to its records.
//!
//! Three exact facts make one set of walks serve every pixel, albedo and channel of a transport point: only the
//! base's reflectance depends on x (so a walk is shifted, not repeated), the albedo factors out as α^n, and the
//! channels differ in the base alone. See ARCHITECTURE.md.
//!
//! The result is a function of the job alone. Walks draw from counter-based streams; batches are grouped into
//! chunks of a fixed size and the chunks' sums merged in their order, whichever thread was done first.

mod fresnel;
mod math;
mod microfacet;
mod phase;
mod powers;
mod rng;
mod stack;
mod tally;
#[cfg(test)]
mod testing;
mod walk;
#[cfg(test)]
mod walk_tests;

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use farm_proto::digest::stream_key;
use farm_proto::grid::BATCH_WALKS;
use farm_proto::job::JobSpec;
use farm_proto::profile::Record;
use rayon::prelude::*;

use powers::AlbedoPowers;
use rng::Stream;
use stack::Stack;
use tally::{Partial, Tally};

/// Batches whose sums are added up one after the other: a unit of parallel work. Part of the physics version,
/// since it fixes the order of sums.
const CHUNK_BATCHES: u64 = 10;

/// Memory of the sums that may wait to be merged, per job.
const WAVE_BYTES: usize = 64 << 20;

/// Tracing was stopped from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("tracing was stopped before the end")]
pub struct Stopped;

/// Traces a job on the current rayon pool and returns one record per albedo. Looks at `stop` after every batch.
pub fn trace(job: &JobSpec, stop: &AtomicBool) -> Result<Vec<Record>, Stopped> {
    let tracer = Tracer {
        job,
        stack: Stack::new(job.scene(), &job.point()),
        powers: AlbedoPowers::new(job.albedo()),
        key: stream_key(job.seed(), &job.point()),
        stop,
    };
    let batches = job.walks().batches();
    let chunks = batches.div_ceil(CHUNK_BATCHES);
    let mut total = Partial::new(job);
    // Waves bound the memory: sums of one wave at a time wait for their turn.
    let most = 2 * rayon::current_num_threads().max(1);
    let wave = (WAVE_BYTES / total.bytes()).clamp(1, most) as u64;
    for first in (0..chunks).step_by(wave as usize) {
        let wave = first..(first + wave).min(chunks);
        let sums: Vec<Result<Partial, Stopped>> = wave
            .into_par_iter()
            .map(|chunk| tracer.chunk(chunk * CHUNK_BATCHES..((chunk + 1) * CHUNK_BATCHES).min(batches)))
            .collect();
        for sum in sums {
            total.merge(&sum?);
        }
    }
    Ok(total.into_records(job))
}

struct Tracer<'a> {
    job: &'a JobSpec,
    stack: Stack,
    powers: AlbedoPowers,
    key: [u32; 2],
    stop: &'a AtomicBool,
}

impl Tracer<'_> {
    fn chunk(&self, batches: Range<u64>) -> Result<Partial, Stopped> {
        let mut partial = Partial::new(self.job);
        let mut tally = Tally::new(self.job, &self.powers);
        let mut hits_mm = Vec::new();
        for batch in batches {
            if self.stop.load(Ordering::Relaxed) {
                return Err(Stopped);
            }
            self.batch(batch, &mut tally, &mut hits_mm);
            tally.finish_batch(&mut partial);
        }
        Ok(partial)
    }

    fn batch(&self, batch: u64, tally: &mut Tally<'_>, hits_mm: &mut Vec<f32>) {
        let [inner, outer] = self.stack.ring_sin2;
        for index in 0..BATCH_WALKS as u32 {
            let stream = Stream::new(self.key, batch, index);
            if let Some(exit) = walk::run(&self.stack, stream, hits_mm)
                && (inner..=outer).contains(&exit.sin2)
            {
                tally.add(&exit, hits_mm);
            }
        }
    }
}
