//! Describes a result on its way to the store: the decision before it is stored, and the facts that are noted afterwards.

use farm_proto::ids::WorkerId;
use farm_proto::lease::LeaseKey;
use optics_model::job::JobSpec;
use optics_model::{Digest, Quality, Walks};

use super::part::{JobRef, PartId};
use crate::stored::Origin;

/// The decision about a result that has arrived.
#[derive(Debug, Clone, PartialEq)]
pub enum Admission {
    /// Store it, if it reaches the target error.
    Store { job: JobSpec, by: Origin, quality: Option<Quality> },
    /// The job is done: compare it with what is stored.
    Compare { job: JobSpec, by: Origin, stored: Digest },
    /// A block that is stored already, or was merged: nothing is left to compare with.
    Repeated { job: JobSpec },
}

impl Admission {
    /// The job that was computed, with its number of walks.
    pub fn job(&self) -> &JobSpec {
        match self {
            Self::Store { job, .. } | Self::Compare { job, .. } | Self::Repeated { job } => job,
        }
    }
}

/// A result that has reached the store.
#[derive(Debug)]
pub struct Arrived<'a> {
    pub worker: &'a WorkerId,
    /// The worker's machine, also if the worker is no longer registered.
    pub by: Origin,
    pub key: &'a LeaseKey,
    /// Walks of its whole job.
    pub walks: Walks,
    /// Digest of the records, or of the sums of a block.
    pub digest: Digest,
}

impl Arrived<'_> {
    pub fn part(&self) -> PartId {
        PartId::from(self.key)
    }

    pub fn job(&self) -> JobRef {
        (self.key.dictionary, self.key.job)
    }
}
