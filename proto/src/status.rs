//! How far dictionaries and workers are.

use crate::digest::Digest;
use crate::grid::Grid;
use crate::ids::{DictionaryName, WorkerId};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DictionaryState {
    Running,
    Done,
    /// All other jobs are done, some have failed for good.
    Failed,
}

impl DictionaryState {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
        }
    }
}

/// A job given up after too many failed attempts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FailedJob {
    pub job: u32,
    pub reason: String,
}

#[derive(Debug, Clone, PartialEq)]
pub struct DictionaryStatus {
    pub name: DictionaryName,
    pub grid: Grid,
    pub grid_digest: Digest,
    /// Digest of all records; present when all jobs are done.
    pub records_digest: Option<Digest>,
    pub created_unix_ms: u64,
    pub jobs_done: usize,
    pub jobs_leased: usize,
    pub failed: Vec<FailedJob>,
    /// Share of the estimated work that is done, 0 to 1.
    pub work_done: f64,
}

impl DictionaryStatus {
    pub fn jobs_total(&self) -> usize {
        self.grid.job_count()
    }

    pub fn records_total(&self) -> usize {
        self.grid.record_count()
    }

    pub fn records_done(&self) -> usize {
        self.jobs_done * self.grid.albedo().len()
    }

    pub fn state(&self) -> DictionaryState {
        if self.jobs_done == self.jobs_total() {
            DictionaryState::Done
        } else if self.jobs_done + self.failed.len() == self.jobs_total() {
            DictionaryState::Failed
        } else {
            DictionaryState::Running
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WorkerStatus {
    pub id: WorkerId,
    pub label: String,
    pub threads: u32,
    pub leases: u32,
    pub jobs_done: u64,
    pub silent_ms: u64,
}
