//! What a transition of the dispatcher produced: effects, events, counts and wake-ups. The scheduler empties it after each
//! transition.

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;

use super::part::Purpose;
use crate::stored::{OpenCheck, Origin};

/// All that was produced since it was last taken.
#[derive(Debug, Default)]
pub struct Outbox {
    /// What must be made durable, in this order.
    pub effects: Vec<Effect>,
    pub events: Vec<Event>,
    pub counts: Vec<Count>,
    /// There may be work for a worker that waits.
    pub work: bool,
    /// People who watch may see something new.
    pub changed: bool,
}

impl Outbox {
    /// There may be work for a worker that waits, and people may see something new.
    pub fn work_came(&mut self) {
        (self.work, self.changed) = (true, true);
    }
}

/// Something that the metrics count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    Granted(Purpose),
    /// Leases whose workers were silent too long.
    Expired(usize),
    GivenUp {
        quarantined: bool,
    },
    /// A comparison between workers that found the same.
    Agreed,
    /// A comparison that did not.
    Disputed,
}

/// Something that the store has to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Effect {
    GiveUp {
        dictionary: DictionaryId,
        job: u32,
        reason: String,
        quarantined: bool,
    },
    /// Set a job's records aside, until it has been computed again.
    Recompute {
        dictionary: DictionaryId,
        job: u32,
    },
    /// Note that a machine has found a job's records to be right: after a restart they need no other check.
    Agreed {
        dictionary: DictionaryId,
        job: u32,
        machine: Origin,
    },
    /// Note how a check stands; it is over if it has no votes.
    NoteCheck(OpenCheck),
    /// Set all aside that a machine alone stands for.
    Fence {
        machine: Origin,
        reason: String,
    },
    /// Let a machine in again, and take back what was set aside with it.
    LiftFence {
        machine: Origin,
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
    WorkerReadmitted,
    WorkerSuspended,
    BackupMade,
    BackupFailed,
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
            Self::WorkerReadmitted => "WORKER_READMITTED",
            Self::WorkerSuspended => "WORKER_SUSPENDED",
            Self::BackupMade => "BACKUP_MADE",
            Self::BackupFailed => "BACKUP_FAILED",
        }
    }
}

/// Something that people may want to know later.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Event {
    pub kind: EventKind,
    /// Name of the dictionary; empty if it concerns none.
    pub dictionary: String,
    pub job: Option<u32>,
    /// Label of the worker; empty if it concerns none.
    pub worker: String,
    pub message: String,
    /// The caller that caused it, and its address; empty if the farm did. The scheduler adds it.
    pub actor: String,
}

impl Event {
    pub fn of_farm(kind: EventKind, message: impl Into<String>) -> Self {
        Self {
            kind,
            dictionary: String::new(),
            job: None,
            worker: String::new(),
            message: message.into(),
            actor: String::new(),
        }
    }

    pub fn of_dictionary(kind: EventKind, name: &DictionaryName, message: impl Into<String>) -> Self {
        Self { dictionary: name.to_string(), ..Self::of_farm(kind, message) }
    }

    pub fn of_worker(kind: EventKind, worker: impl Into<String>, message: impl Into<String>) -> Self {
        Self::of_farm(kind, message).by(worker)
    }

    pub fn of_job(kind: EventKind, name: &DictionaryName, job: u32, message: impl Into<String>) -> Self {
        Self { job: Some(job), ..Self::of_dictionary(kind, name, message) }
    }

    #[must_use]
    pub fn by(self, worker: impl Into<String>) -> Self {
        Self { worker: worker.into(), ..self }
    }
}
