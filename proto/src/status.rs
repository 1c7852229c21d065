//! Describes the state and progress of dictionaries, jobs and workers.

use std::fmt;

use crate::ids::{DictionaryName, WorkerId};
use optics_model::digest::Digest;
use optics_model::grid::Grid;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DictionaryState {
    Running,
    Done,
    /// All other jobs are done, some have been given up.
    Failed,
    /// No jobs are leased until it is resumed.
    Paused,
    /// Ended by a user; finished records stay.
    Cancelled,
    /// Begun with another physics version: not continued.
    Outdated,
}

impl DictionaryState {
    pub const ALL: [Self; 6] =
        [Self::Running, Self::Done, Self::Failed, Self::Paused, Self::Cancelled, Self::Outdated];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Paused => "paused",
            Self::Cancelled => "cancelled",
            Self::Outdated => "outdated",
        }
    }

    /// Whether it is running or paused; in every other state its work has ended.
    pub fn is_open(self) -> bool {
        matches!(self, Self::Running | Self::Paused)
    }
}

/// The state of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum JobState {
    Waiting,
    /// A worker has leased it, or a part of it.
    Computing,
    Done,
    /// Done, and the coordinator has computed the same.
    Checked,
    Failed,
}

impl JobState {
    pub const ALL: [Self; 5] = [Self::Waiting, Self::Computing, Self::Done, Self::Checked, Self::Failed];
}

/// The reason of dictionaries that a command has left unfinished.
pub const INTERRUPTED: &str = "interrupted";

/// Largest number of failed jobs in a status; complete lists come in pages.
pub const FAILED_JOBS: usize = 1000;

/// A job given up after too many failed attempts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FailedJob {
    pub job: u32,
    pub reason: String,
    /// Workers fell silent while they computed it; otherwise they reported that they could not compute it.
    pub quarantined: bool,
}

#[derive(Debug, Clone, PartialEq)]
pub struct DictionaryStatus {
    pub name: DictionaryName,
    pub grid: Grid,
    pub grid_digest: Digest,
    /// Digest of all records; present when all jobs are done.
    pub records_digest: Option<Digest>,
    pub created_unix_ms: u64,
    pub state: DictionaryState,
    pub jobs_done: usize,
    pub jobs_leased: usize,
    /// Jobs about which machines disagree, whether or not they are done.
    pub jobs_disputed: usize,
    /// Number of jobs that were given up.
    pub jobs_failed: usize,
    /// The first of them, [`FAILED_JOBS`] at most.
    pub failed: Vec<FailedJob>,
    /// Share of the estimated work that is done, 0 to 1.
    pub work_done: f64,
    /// Dictionaries with a higher priority are served first.
    pub priority: i32,
    /// Reason of the cancellation; empty if it was not cancelled.
    pub reason: String,
    /// Name of the token with which it was submitted; empty without a token.
    pub owner: String,
    /// Time until it is done at the present pace; None if unknown.
    pub eta_s: Option<f64>,
    /// The dictionary for which this one waits: it is served first, and no job of this one is being computed.
    pub goes_first: Option<DictionaryName>,
    /// Records that existed before it was submitted.
    pub records_reused: usize,
    /// Fewest and most walks of the points that are done; zeros if there are none.
    pub walks: (u64, u64),
}

impl DictionaryStatus {
    pub fn jobs_total(&self) -> usize {
        self.grid.job_count()
    }

    /// Records of the axes and of the responses.
    pub fn records_total(&self) -> usize {
        self.grid.stored_records()
    }

    pub fn records_done(&self) -> usize {
        self.jobs_done * self.grid.albedo().len()
    }

    pub fn state(&self) -> DictionaryState {
        self.state
    }

    /// Whether it waits because the command that computed it has ended.
    pub fn is_interrupted(&self) -> bool {
        self.state == DictionaryState::Cancelled && self.reason == INTERRUPTED
    }

    /// Whether the workers of some of the jobs given up fell silent.
    pub fn has_quarantined(&self) -> bool {
        self.failed.iter().any(|f| f.quarantined)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum WorkerState {
    Working,
    Idle,
    /// Finishes its jobs and leaves.
    Draining,
    /// Computed wrong records: gets no more jobs.
    Fenced,
    /// Has made no call for longer than a lease is valid.
    Silent,
    /// Fails one job after the other: gets none for a while.
    Suspended,
}

impl fmt::Display for WorkerState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Working => "working",
            Self::Idle => "idle",
            Self::Draining => "draining",
            Self::Fenced => "fenced",
            Self::Silent => "silent",
            Self::Suspended => "suspended",
        })
    }
}

/// Hardware of a machine, as reported by its worker; zeros and empty texts where unknown.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MachineFacts {
    /// Cores that the worker may use.
    pub cores: u32,
    pub memory_bytes: u64,
    /// The kernel that it traces with.
    pub kernel: String,
    /// The place at which its log can be read, as in `HOST:/var/log/slurm-17.out`; empty if unknown.
    pub log: String,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WorkerStatus {
    pub id: WorkerId,
    pub label: String,
    pub threads: u32,
    pub leases: u32,
    pub jobs_done: u64,
    pub silent_ms: u64,
    pub state: WorkerState,
    /// Remaining time without jobs; 0 if it is not suspended.
    pub suspended_ms: u64,
    pub version: String,
    pub facts: MachineFacts,
    /// Identity of the machine for the coordinator: `TOKEN@ADDRESS`.
    pub machine: String,
}
