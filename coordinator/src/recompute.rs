//! Computes a job on the coordinator's own machine, with the same bits as a worker.

use std::sync::atomic::AtomicBool;

use farm_link::memory::usable_bytes;
use optics_layers::{block_of_set, records};
use optics_model::PackedRecords;
use optics_model::job::JobSpec;
use optics_model::sums::Sums;

use crate::stored::JobResult;

/// Computes a job, or its block, on the current rayon pool. The error is the reason why it cannot.
pub type Recompute = fn(&JobSpec) -> Result<JobResult, String>;

/// Copies of a job's sums that are in memory while it is computed.
const COPIES: u64 = 4;

/// Computes a job as workers do, if a quarter of the memory that this process may use suffices.
pub fn recompute(job: &JobSpec) -> Result<JobResult, String> {
    static NEVER: AtomicBool = AtomicBool::new(false);
    let needed = COPIES * Sums::bytes(job) as u64;
    if usable_bytes().is_some_and(|usable| needed > usable / 4) {
        return Err(format!("it needs {} MiB of memory", needed >> 20));
    }
    let stopped = |_| "it was stopped".to_owned();
    Ok(match job.block() {
        Some(block) => {
            let sums = block_of_set(std::slice::from_ref(job), block, &NEVER).map_err(stopped)?;
            JobResult::Sums(sums[0].to_le_bytes().into())
        }
        None => JobResult::Records(PackedRecords::pack(job, &records(job, &NEVER).map_err(stopped)?)),
    })
}
