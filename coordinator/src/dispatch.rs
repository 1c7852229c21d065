//! Decides which job goes to which worker: a state machine over plain data.
//!
//! Synchronous, and without access to clocks, randomness, network and store: time comes in as a monotonic [`Duration`],
//! tokens from a [`TokenSource`], results as calls. What must be made durable, recorded, counted or woken is in the
//! [`Outbox`].
//!
//! Three modules own the state: `schedule` the jobs and leases, `verification` the results that the coordinator is to
//! compute itself, `roster` the workers and machines. Verification reads the schedule and the roster, and the schedule
//! reads the roster.

mod admission;
mod attempts;
mod dispatcher;
mod mac;
#[cfg(test)]
mod model_tests;
mod outbox;
mod part;
mod roster;
mod schedule;
#[cfg(test)]
mod tests;
mod verification;

use std::time::Duration;

use farm_proto::ids::{Token, WorkerId};
use farm_proto::lease::Lease;

use crate::stored::Secret;
pub use admission::{Admission, Arrived};
pub use dispatcher::Dispatcher;
pub use outbox::{Count, Effect, Event, EventKind, Outbox};
pub use part::{JobRef, PartId, Purpose};
pub use roster::Registration;
pub use schedule::{Dictionary, LeaseRequest, PERIOD, Period, Plan, Reason};
pub use verification::Verdict;

#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Duration of a lease from its grant or its last renewal.
    pub lease: Duration,
    /// Failed attempts after which a job is given up.
    pub max_attempts: u32,
    /// Share of the results that the coordinator computes too, for comparison.
    pub check_share: f64,
    /// Key for the sampling of these results, and for the tokens of leases and workers.
    pub secret: Secret,
}

/// A source of tokens for leases.
pub trait TokenSource {
    /// A token that cannot be guessed.
    fn token(&mut self) -> Token;
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DispatchError {
    #[error("worker {0} is not registered here: register again")]
    UnknownWorker(WorkerId),
    #[error("this worker is fenced off: {0}")]
    Fenced(String),
    #[error("lease of job {job} (attempt {attempt}) is no longer held: drop the result")]
    LeaseLost { job: u32, attempt: u32 },
    #[error(
        "{most} workers with this token are registered already: give some a token of their own (farmctl access add)"
    )]
    ManyWorkers { most: usize },
    #[error("dictionary number {0} has no such job: drop the result")]
    UnknownJob(i64),
}

/// Leases that were given out, and whether the worker is to leave.
#[derive(Debug, Default)]
pub struct Grant {
    pub leases: Vec<Lease>,
    pub drain: bool,
}
