//! Identifies units of work: jobs of dictionaries, their parts, and the purposes of leases.

use farm_proto::ids::DictionaryId;
use farm_proto::lease::LeaseKey;

/// A job of a dictionary.
pub type JobRef = (DictionaryId, u32);

/// A unit of work: a job, or one block of a divided job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PartId {
    pub dictionary: DictionaryId,
    pub job: u32,
    pub part: u32,
}

impl PartId {
    /// The first part of a job: the whole of it, unless it is divided.
    pub fn first_of((dictionary, job): JobRef) -> Self {
        Self { dictionary, job, part: 0 }
    }

    pub fn job_ref(self) -> JobRef {
        (self.dictionary, self.job)
    }

    /// All parts that a job may have.
    pub fn range_of((dictionary, job): JobRef) -> std::ops::RangeInclusive<Self> {
        let part = |part| Self { dictionary, job, part };
        part(0)..=part(u32::MAX)
    }
}

impl From<&LeaseKey> for PartId {
    fn from(key: &LeaseKey) -> Self {
        Self { dictionary: key.dictionary, job: key.job, part: key.part }
    }
}

/// The purpose of a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Purpose {
    First,
    /// Another attempt, after one without a result.
    Retry,
    /// A second copy of a part whose first takes too long.
    Copy,
}
