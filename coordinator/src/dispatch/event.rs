//! What the dispatcher tells: effects that must be made durable, and events for people.

use farm_proto::ids::DictionaryId;

use crate::stored::Origin;

/// Something that the store has to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Effect {
    GiveUp {
        dictionary: DictionaryId,
        job: u32,
        reason: String,
        quarantined: bool,
    },
    /// Forget a job's records.
    Recompute {
        dictionary: DictionaryId,
        job: u32,
    },
    /// Note that a worker has found a job's records to be right: after a restart they need no other check.
    Agreed {
        dictionary: DictionaryId,
        job: u32,
        worker: Origin,
    },
    /// Forget all that a worker has computed.
    Fence {
        worker: Origin,
        reason: String,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EventKind {
    CoordinatorStarted,
    Submitted,
    Done,
    Ended,
    Paused,
    Resumed,
    Cancelled,
    Retried,
    PriorityChanged,
    Deleted,
    AttemptFailed,
    JobFailed,
    JobQuarantined,
    JobDamaged,
    ResultsDiffer,
    WorkerJoined,
    WorkerLeft,
    WorkerGone,
    WorkerDraining,
    WorkerFenced,
    BackupMade,
}

impl EventKind {
    /// As programs see it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::CoordinatorStarted => "COORDINATOR_STARTED",
            Self::Submitted => "SUBMITTED",
            Self::Done => "DONE",
            Self::Ended => "ENDED",
            Self::Paused => "PAUSED",
            Self::Resumed => "RESUMED",
            Self::Cancelled => "CANCELLED",
            Self::Retried => "RETRIED",
            Self::PriorityChanged => "PRIORITY_CHANGED",
            Self::Deleted => "DELETED",
            Self::AttemptFailed => "ATTEMPT_FAILED",
            Self::JobFailed => "JOB_FAILED",
            Self::JobQuarantined => "JOB_QUARANTINED",
            Self::JobDamaged => "JOB_DAMAGED",
            Self::ResultsDiffer => "RESULTS_DIFFER",
            Self::WorkerJoined => "WORKER_JOINED",
            Self::WorkerLeft => "WORKER_LEFT",
            Self::WorkerGone => "WORKER_GONE",
            Self::WorkerDraining => "WORKER_DRAINING",
            Self::WorkerFenced => "WORKER_FENCED",
            Self::BackupMade => "BACKUP_MADE",
        }
    }
}

/// Something that people may want to know later.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Event {
    pub kind: EventKind,
    pub dictionary: Option<DictionaryId>,
    pub job: Option<u32>,
    /// Label of the worker; empty if it concerns none.
    pub worker: String,
    pub message: String,
}

impl Event {
    pub fn of_farm(kind: EventKind, message: impl Into<String>) -> Self {
        Self { kind, dictionary: None, job: None, worker: String::new(), message: message.into() }
    }

    pub fn of_dictionary(kind: EventKind, dictionary: DictionaryId, message: impl Into<String>) -> Self {
        Self { dictionary: Some(dictionary), ..Self::of_farm(kind, message) }
    }

    pub fn of_worker(kind: EventKind, worker: impl Into<String>, message: impl Into<String>) -> Self {
        Self { worker: worker.into(), ..Self::of_farm(kind, message) }
    }
}
