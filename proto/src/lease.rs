//! Defines leases: jobs that are given to workers until a deadline.

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

/// A job given to a worker until a deadline.
#[derive(Debug, Clone, PartialEq)]
pub struct Lease {
    pub key: LeaseKey,
    pub job: JobSpec,
}
