//! What the port for figures tells.

use farm_proto::status::{DictionaryState, WorkerState};

use super::Farm;
use crate::web::{DictionaryFigures, Figures, JobFigures, WorkerFigures};

impl Farm {
    /// States and progress now.
    pub(crate) fn figures(&self) -> Figures {
        let database_bytes = self.store.bytes();
        let (dispatch, now) = (self.dispatch(), self.clock.now());
        let mut figures = Figures { database_bytes, ..Figures::default() };
        let (pending, leased) = dispatch.load();
        figures.jobs = JobFigures { pending: pending as u64, leased: leased as u64, ..JobFigures::default() };
        for dictionary in dispatch.dictionaries() {
            let (done, failed) = dictionary.ended();
            figures.jobs.done += done as u64;
            figures.jobs.failed += failed as u64;
            let DictionaryFigures { running, paused, done, failed, cancelled } = &mut figures.dictionaries;
            *match dictionary.state() {
                DictionaryState::Running => running,
                DictionaryState::Paused => paused,
                DictionaryState::Done => done,
                DictionaryState::Failed => failed,
                DictionaryState::Cancelled | DictionaryState::Outdated => cancelled,
            } += 1;
            figures.work_done.push((dictionary.name().to_string(), dictionary.work_done()));
        }
        // Those that are still at work are the most interesting, then the newest.
        figures.work_done.reverse();
        figures.work_done.sort_by_key(|(_, done)| *done >= 1.0);
        for worker in dispatch.workers(now, &farm_proto::ids::WorkerId(String::new()), usize::MAX) {
            let WorkerFigures { working, idle, draining, silent } = &mut figures.workers;
            *match worker.state {
                WorkerState::Fenced => continue,
                WorkerState::Silent => silent,
                WorkerState::Draining => draining,
                WorkerState::Working => working,
                WorkerState::Idle => idle,
            } += 1;
        }
        figures
    }

    /// Why it cannot serve, if it cannot.
    pub(crate) fn ready(&self) -> Result<(), String> {
        match self.overview().store_fault {
            Some(fault) => Err(format!("results cannot be stored: {fault}")),
            None => Ok(()),
        }
    }
}
