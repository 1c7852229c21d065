//! Defines the types of the stored data. The store maps its rows to them, and `dispatch` begins from them after a
//! restart, so that neither depends on the other.

use std::sync::Arc;

use bytes::Bytes;
use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;
use optics_model::job::JobSpec;
use optics_model::{Digest, Grid, PackedRecords, Quality, Walks};

/// The state that a user has requested for a dictionary.
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
    /// The reason that was given for the desired state; may be empty.
    pub reason: String,
    /// Name of the token with which it was submitted; empty where none was presented.
    pub owner: String,
}

/// The end of a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EndedJob {
    Done {
        job: u32,
        walks: Walks,
        records: Digest,
        /// The machine that computed it, if one did it alone.
        by: Option<Origin>,
        /// The coordinator has computed the same records.
        verified: bool,
        /// Its records were stored before, for another dictionary.
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

/// A machine, by the number of its row in the store. Results are traced back to it, however many processes run there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Origin(pub i64);

/// The machine of a worker. Token and address are observed by the coordinator; the host is claimed by the worker.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Machine {
    /// Name of the token that it has presented; empty if none is required.
    pub token: String,
    /// The other end of its connection; empty if that is this process.
    pub address: String,
    /// Distinguishes the machine from others, as the worker itself claims; may be empty.
    pub host: String,
}

impl Machine {
    #[cfg(test)]
    pub(crate) fn at(address: &str) -> Self {
        Self { address: address.to_owned(), ..Self::default() }
    }

    /// The key of the machine in the store. A worker cannot choose it: it could change its identity at will.
    pub fn identity(&self) -> String {
        format!("{}@{}", self.token, self.address)
    }

    /// Whether both are the same machine, provided that the claimed hosts are true: a worker that was started again may
    /// come from another address.
    pub fn is_same(&self, other: &Self) -> bool {
        let same_host = !self.host.is_empty() && self.host == other.host;
        self.token == other.token && (self.address == other.address || same_host)
    }
}

/// A machine in the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KnownMachine {
    pub origin: Origin,
    pub machine: Machine,
    /// The last label of its worker.
    pub label: String,
    /// The reason why it is fenced off, if it is.
    pub fenced: Option<String>,
}

/// One machine's result, as its digest. The machine is unknown if there were several, or if a former version did not note
/// it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Claim {
    pub by: Option<Origin>,
    pub digest: Digest,
}

/// A part that the coordinator is to compute: a job, or one block of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenCheck {
    pub dictionary: DictionaryId,
    pub job: u32,
    pub block: u32,
    pub claims: Vec<Claim>,
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
    /// The target error, if the records must reach one.
    pub quality: Option<Quality>,
}

#[derive(Debug)]
pub enum JobResult {
    Records(PackedRecords),
    /// Sums of the job's block.
    Sums(Bytes),
}

/// The outcome of storing a result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// The job is done.
    Finished { records: Digest },
    /// A block is stored; others are missing.
    Part,
    /// The target error is not reached: nothing is kept, and more walks are needed.
    MoreWalks(Walks),
    /// Nothing is kept: the dictionary was deleted, the worker is fenced off, or the job is done and the result cannot be
    /// compared with its records.
    Unwanted,
    /// The job was done before. `records` is the digest of its records, `new` that of the result, which may be the same.
    Before { records: Digest, new: Digest },
    /// Nothing is kept: another job has stored other records for the same walks.
    Differs,
    /// A block that is stored already, or was merged: nothing is left to compare with.
    Repeated,
}

/// The kind of an outcome, for the worker and for the metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutcomeKind {
    Stored,
    /// An equal result was stored before.
    Duplicate,
    /// Different records are stored.
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

    /// The label under which it is counted. None for results that are not needed.
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
