//! Reports the progress of a dictionary to clients.

use std::ops::Range;

use farm_proto::DictionaryName;
use farm_proto::status::{DictionaryState, DictionaryStatus, FAILED_JOBS, FailedJob};
use optics_model::Digest;

use super::Dictionary;
use super::job::{Job, Stage};
use crate::stored::DesiredState;

impl Dictionary {
    pub fn state(&self) -> DictionaryState {
        if self.counts.done == self.jobs.len() {
            return DictionaryState::Done;
        }
        if self.outdated {
            return DictionaryState::Outdated;
        }
        match self.stored.desire {
            _ if self.too_large.is_some() => DictionaryState::Cancelled,
            DesiredState::Cancel => DictionaryState::Cancelled,
            _ if self.open_jobs() == 0 => DictionaryState::Failed,
            DesiredState::Pause => DictionaryState::Paused,
            DesiredState::Run => DictionaryState::Running,
        }
    }

    /// Number of finished records in a range.
    pub fn finished_records(&self, range: Range<usize>) -> usize {
        let albedos = self.grid().albedo().len();
        let finished = |job: usize| {
            let done = self.jobs.get(job).is_some_and(|job| matches!(job.stage, Stage::Done(_)));
            let of_job = range.start.max(job * albedos)..range.end.min((job + 1) * albedos);
            if done { of_job.len() } else { 0 }
        };
        (range.start / albedos..range.end.div_ceil(albedos)).map(finished).sum()
    }

    /// Remaining work, in scatterings.
    pub fn cost_left(&self) -> f64 {
        (self.counts.cost - self.counts.cost_done).max(0.0)
    }

    pub fn work_done(&self) -> f64 {
        if self.counts.done == self.jobs.len() { 1.0 } else { self.counts.cost_done / self.counts.cost }
    }

    pub(super) fn status(
        &self,
        eta_s: Option<f64>,
        goes_first: Option<DictionaryName>,
        jobs_disputed: usize,
    ) -> DictionaryStatus {
        DictionaryStatus {
            name: self.stored.name.clone(),
            grid: (*self.stored.grid).clone(),
            grid_digest: self.stored.grid_digest,
            records_digest: self.records_digest(),
            created_unix_ms: self.stored.created_unix_ms,
            state: self.state(),
            jobs_done: self.counts.done,
            jobs_leased: self.leased(),
            jobs_disputed,
            jobs_failed: self.counts.given_up,
            failed: self.given_up(0, FAILED_JOBS),
            work_done: self.work_done(),
            priority: self.stored.priority,
            reason: self.stored.reason.clone(),
            owner: self.stored.owner.clone(),
            eta_s: eta_s.filter(|_| self.state() == DictionaryState::Running),
            goes_first,
            records_reused: self.counts.reused * self.grid().albedo().len(),
            walks: self.counts.walks.unwrap_or_default(),
        }
    }

    fn records_digest(&self) -> Option<Digest> {
        if self.counts.done < self.jobs.len() {
            return None;
        }
        let digest = |job: &Job| match job.stage {
            Stage::Done(done) => Some(done.records),
            _ => None,
        };
        self.jobs.iter().map(digest).collect::<Option<Vec<_>>>().map(Digest::of_jobs)
    }

    /// Jobs that were given up, from the index `from` on, `most` at most.
    pub fn given_up(&self, from: u32, most: usize) -> Vec<FailedJob> {
        if self.counts.given_up == 0 {
            return Vec::new();
        }
        let failed = |(job, index): (&Job, u32)| match &job.stage {
            Stage::GivenUp { reason, quarantined } => {
                Some(FailedJob { job: index, reason: reason.clone(), quarantined: *quarantined })
            }
            _ => None,
        };
        let rest = self.jobs.iter().zip(0..).skip(from as usize);
        rest.filter_map(failed).take(most).collect()
    }
}
