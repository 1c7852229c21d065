//! Collects states and counts at one moment, for the port of the metrics.

use std::sync::PoisonError;
use std::time::Duration;

use farm_proto::status::{DictionaryState, WorkerState};

use super::Farm;
use crate::dispatch::Dispatcher;
use crate::metrics::{DictionaryCounts, JobCounts, Snapshot, WorkerCounts};

impl Farm {
    /// States and progress now.
    pub(crate) fn snapshot(&self) -> Snapshot {
        let database_bytes = self.store.bytes();
        let last_backup = *self.last_backup.lock().unwrap_or_else(PoisonError::into_inner);
        let backup_age_s = last_backup.map(|made| made.elapsed().as_secs_f64());
        Snapshot { database_bytes, backup_age_s, ..self.scheduler.query(snapshot) }
    }

    /// Whether the farm can serve; the error is the reason why it cannot.
    pub(crate) fn ready(&self) -> Result<(), String> {
        match self.store_fault() {
            Some(fault) => Err(format!("results cannot be stored: {fault}")),
            None => Ok(()),
        }
    }
}

fn snapshot(dispatcher: &Dispatcher, now: Duration) -> Snapshot {
    let mut snapshot = Snapshot::default();
    let (pending, leased) = dispatcher.schedule().load();
    snapshot.jobs = JobCounts { pending: pending as u64, leased: leased as u64, ..JobCounts::default() };
    for dictionary in dispatcher.schedule().dictionaries() {
        let (done, failed) = dictionary.ended();
        snapshot.jobs.done += done as u64;
        snapshot.jobs.failed += failed as u64;
        let DictionaryCounts { running, paused, done, failed, cancelled } = &mut snapshot.dictionaries;
        *match dictionary.state() {
            DictionaryState::Running => running,
            DictionaryState::Paused => paused,
            DictionaryState::Done => done,
            DictionaryState::Failed => failed,
            DictionaryState::Cancelled | DictionaryState::Outdated => cancelled,
        } += 1;
        snapshot.work_done.push((dictionary.name().to_string(), dictionary.work_done()));
    }
    // Unfinished dictionaries come first, then the others, the newest first among both.
    snapshot.work_done.reverse();
    snapshot.work_done.sort_by_key(|(_, done)| *done >= 1.0);
    for worker in dispatcher.workers(now, &farm_proto::ids::WorkerId(String::new()), usize::MAX) {
        let WorkerCounts { working, idle, draining, silent, suspended } = &mut snapshot.workers;
        *match worker.state {
            WorkerState::Fenced => continue,
            WorkerState::Silent => silent,
            WorkerState::Suspended => suspended,
            WorkerState::Draining => draining,
            WorkerState::Working => working,
            WorkerState::Idle => idle,
        } += 1;
    }
    snapshot
}
