//! Defines leases: jobs that are given to workers until a deadline.

use optics_model::Digest;
use optics_model::invalid::{Invalid, Result};
use optics_model::job::JobSpec;

use crate::ids::{DictionaryId, Token};

/// Identifies one attempt at one job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LeaseKey {
    pub dictionary: DictionaryId,
    pub job: u32,
    /// Counts the leases of the job, from 1.
    pub attempt: u32,
    /// Random; proves that the holder was granted this attempt.
    pub token: Token,
    /// The part of the job: the block of walks if it is divided, else 0.
    pub part: u32,
}

/// A lease that a worker holds and renews.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HeldLease {
    pub key: LeaseKey,
    /// Whether its part is being traced; otherwise it waits for a thread.
    pub running: bool,
    /// Digest of all that the records of its part depend on.
    pub identity: Digest,
}

/// A job given to a worker until a deadline.
#[derive(Debug, Clone, PartialEq)]
pub struct Lease {
    pub key: LeaseKey,
    pub job: JobSpec,
}

/// The digest of all that a job's records depend on, as it was sent with the job.
pub fn job_identity(bytes: &[u8]) -> Result<Digest> {
    let digest = bytes.try_into().map(Digest::from_bytes);
    digest.map_err(|_| Invalid::new("identity", format_args!("{} bytes", bytes.len()), "32 are needed"))
}
