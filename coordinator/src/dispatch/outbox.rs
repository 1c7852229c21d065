//! Collects the output of a transition of the dispatcher: effects, events, counts and wake-ups. The scheduler empties it
//! after each transition.

use farm_proto::DictionaryName;
use farm_proto::ids::DictionaryId;

use super::part::Purpose;
use crate::stored::OpenCheck;

/// Everything that was produced since the outbox was last emptied.
#[derive(Debug, Default)]
pub struct Outbox {
    /// Changes that must be made durable, in this order.
    pub effects: Vec<Effect>,
    pub events: Vec<Event>,
    pub counts: Vec<Count>,
    /// There may be work for a waiting worker.
    pub work: bool,
    /// There may be a change for watching clients.
    pub changed: bool,
}

impl Outbox {
    /// Notes that there may be work for a waiting worker, and a change for watching clients.
    pub fn work_came(&mut self) {
        (self.work, self.changed) = (true, true);
    }
}

/// Something that the metrics count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    Granted(Purpose),
    /// Leases that expired, or that were renewed too long without a result.
    Expired(usize),
    GivenUp {
        quarantined: bool,
    },
    /// The coordinator has found the same result as all machines.
    Agreed,
    /// The coordinator has found another result than some machine.
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
    /// Note the claims of a check; a check without claims is over.
    NoteCheck(OpenCheck),
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
    WorkerSuspended,
    BackupMade,
    BackupFailed,
}

impl EventKind {
    /// The code of the kind, for programs.
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
            Self::WorkerSuspended => "WORKER_SUSPENDED",
            Self::BackupMade => "BACKUP_MADE",
            Self::BackupFailed => "BACKUP_FAILED",
        }
    }
}

/// An entry of the event log.
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
