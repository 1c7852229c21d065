//! The types of what is stored. The store maps its rows to them, and `dispatch` begins from them after a
//! restart, so that neither depends on the other.

use std::sync::Arc;

use bytes::Bytes;
use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, PackedRecords, Quality, Walks};

/// What people want of a dictionary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DesiredState {
    Run,
    Pause,
    Cancel,
}

impl DesiredState {
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Run => "run",
            Self::Pause => "pause",
            Self::Cancel => "cancel",
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct StoredDictionary {
    pub id: DictionaryId,
    pub name: DictionaryName,
    pub grid: Arc<Grid>,
    pub grid_digest: Digest,
    pub created_unix_ms: u64,
    pub priority: i32,
    pub desire: DesiredState,
    /// Why it was cancelled.
    pub reason: String,
    /// Name of the token with which it was submitted; empty where none was presented.
    pub owner: String,
}

/// How a job ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EndedJob {
    Done {
        job: u32,
        walks: Walks,
        records: Digest,
        /// The machine that computed it, if one did it alone.
        by: Option<Origin>,
        /// Machines that have found the same when they checked it.
        confirmed: Vec<Origin>,
        /// Its records were there before.
        reused: bool,
    },
    GivenUp {
        job: u32,
        reason: String,
        quarantined: bool,
    },
}

impl EndedJob {
    pub fn job(&self) -> u32 {
        match self {
            Self::Done { job, .. } | Self::GivenUp { job, .. } => *job,
        }
    }
}

/// A machine, by the number of its row in the store: what results are traced back to, however
/// many processes run there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Origin(pub i64);

/// Where a worker came from. Token and address are what the coordinator has seen; the host is what the worker claims.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Machine {
    /// Name of the token that it has presented; empty if none is required.
    pub token: String,
    /// The other end of its connection; empty if that is this process.
    pub address: String,
    /// Distinguishes its machine from others, chosen by itself; may be empty.
    pub host: String,
}

impl Machine {
    #[cfg(test)]
    pub(crate) fn at(address: &str) -> Self {
        Self { address: address.to_owned(), ..Self::default() }
    }

    /// What the store knows it by. A worker cannot choose it: it would be another one whenever it liked.
    pub fn identity(&self) -> String {
        format!("{}@{}", self.token, self.address)
    }

    /// Whether both are known to be the same machine, if its host is true: a worker that was started again may come from
    /// another address.
    pub fn is_same(&self, other: &Self) -> bool {
        let same_host = !self.host.is_empty() && self.host == other.host;
        self.token == other.token && (self.address == other.address || same_host)
    }
}

/// A machine that the store knows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KnownMachine {
    pub origin: Origin,
    pub machine: Machine,
    /// What its worker was called last.
    pub label: String,
    /// Why it is fenced off, if it is.
    pub fenced: Option<String>,
}

/// One machine's result, as its digest. The machine may be unknown: several, or a former version did not note it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Vote {
    pub by: Option<Origin>,
    pub digest: Digest,
}

/// A check that is not settled: of a job, or of one block of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenCheck {
    pub dictionary: DictionaryId,
    pub job: u32,
    pub block: u32,
    pub votes: Vec<Vote>,
}

/// Random bytes of this database, which are secret.
#[derive(Clone, Copy)]
pub struct Secret(pub [u8; 32]);

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Secret")
    }
}

/// A result to be stored.
#[derive(Debug)]
pub struct Completion {
    pub dictionary: DictionaryId,
    pub job_number: u32,
    pub job: JobSpec,
    pub worker: Origin,
    pub content: JobResult,
    /// If the records must reach a target error.
    pub quality: Option<Quality>,
}

#[derive(Debug)]
pub enum JobResult {
    Records(PackedRecords),
    /// Sums of the block that the job names.
    Sums(Bytes),
}

/// What became of a result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// The job is done.
    Finished { records: Digest },
    /// A block is stored; others are missing.
    Part,
    /// The target error is not reached: nothing is kept, and more walks are needed.
    MoreWalks(Walks),
    /// Nothing is kept: the dictionary was deleted, the worker is fenced off, or the job is done and this cannot be compared
    /// with its records.
    Unwanted,
    /// The job was done before, with the records that have this digest; these have another, or the same.
    Before { records: Digest, new: Digest },
    /// Nothing is kept: another job has stored other records for the same walks.
    Differs,
    /// A block that is stored already, or was merged: nothing is left to compare with.
    Repeated,
}

/// What an outcome amounts to, for the worker and for the metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutcomeKind {
    Stored,
    /// The same was stored before.
    Duplicate,
    /// Other records are stored than these.
    Conflict,
    Unwanted,
}

impl Outcome {
    pub fn kind(self) -> OutcomeKind {
        match self {
            Self::Finished { .. } | Self::Part | Self::MoreWalks(_) => OutcomeKind::Stored,
            Self::Before { records, new } if records == new => OutcomeKind::Duplicate,
            Self::Repeated => OutcomeKind::Duplicate,
            Self::Before { .. } | Self::Differs => OutcomeKind::Conflict,
            Self::Unwanted => OutcomeKind::Unwanted,
        }
    }
}

impl OutcomeKind {
    /// The labels under which outcomes are counted.
    pub const LABELS: [&str; 3] = ["stored", "duplicate", "conflict"];

    /// The label under which it is counted. None for results that are not wanted any more.
    pub fn label(self) -> Option<&'static str> {
        Self::LABELS.get(self as usize).copied()
    }
}

impl JobResult {
    pub fn digest(&self) -> Digest {
        match self {
            Self::Records(records) => records.digest(),
            Self::Sums(bytes) => Digest::of_bytes(bytes),
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        match self {
            Self::Records(records) => records.bytes().len(),
            Self::Sums(bytes) => bytes.len(),
        }
    }
}
