//! The way of a result from the wire to the disk.

use std::sync::PoisonError;

use farm_proto::ids::WorkerId;
use farm_proto::lease::LeaseKey;
use optics_model::Digest;
use optics_model::job::JobSpec;

use super::records::UNSTEADY;
use super::{Farm, Result};
use crate::dispatch::{Admission, Arrived, Event, EventKind};
use crate::metrics::{JobOutcome, VerificationOutcome};
use crate::store::StoreError;
use crate::stored::Origin;
use crate::stored::{Completion, JobResult, Outcome};

/// What became of a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fate {
    Stored,
    Duplicate,
    Conflict,
    /// Its dictionary was deleted or its worker fenced off while it was on its way, or it is there already.
    Unwanted,
}

impl Farm {
    /// Stores a result, or compares it with what is stored.
    pub(crate) async fn complete(
        &self,
        worker: WorkerId,
        key: LeaseKey,
        admission: Admission,
        content: JobResult,
    ) -> Result<Fate> {
        let outcome = match admission {
            Admission::Store { job, by } => {
                let arrived = Arrived { worker: &worker, by, key: &key, walks: job.walks() };
                self.store_result(&arrived, job.clone(), content).await
            }
            Admission::Compare { by, stored, .. } => Ok(self.compare(by, &key, stored, content.digest())),
            Admission::Repeated { .. } => Ok(Fate::Duplicate),
        };
        self.settle().await;
        self.changed.send_replace(());
        let outcome = outcome?;
        match outcome {
            Fate::Stored => self.metrics.job_completed(JobOutcome::Stored),
            Fate::Duplicate => self.metrics.job_completed(JobOutcome::Duplicate),
            Fate::Conflict => self.metrics.job_completed(JobOutcome::Conflict),
            Fate::Unwanted => {}
        }
        Ok(outcome)
    }

    async fn store_result(&self, arrived: &Arrived<'_>, job: JobSpec, content: JobResult) -> Result<Fate> {
        let key = arrived.key;
        let quality = self.dispatch().by_id(key.dictionary).and_then(|d| d.grid().quality());
        let completion = Completion {
            dictionary: key.dictionary,
            job_number: key.job,
            job,
            worker: arrived.by,
            content,
            quality,
        };
        let nothing_is_forgotten = self.records.read().await;
        let job = completion.job.clone();
        let stored = self.store.complete(completion).await;
        self.note_store_fault(stored.as_ref().err());
        let now = self.clock.now();
        match stored {
            Ok(Outcome::Finished { records }) => {
                self.dispatch().finished(now, arrived, records);
                self.serve_others(key, arrived.by).await;
                if self.dispatch().checks().2 > 0 {
                    self.work.send_replace(());
                }
            }
            Ok(Outcome::Part) => {
                self.dispatch().part_finished(now, arrived);
                // Blocks are shared by dictionaries that ask for the same: another one may have merged those that this one
                // has counted.
                if self.dispatch().waits_for_nothing(key) {
                    self.find_blocks_of(key).await?;
                    self.work.send_replace(());
                }
            }
            Ok(Outcome::MoreWalks(walks)) => {
                self.dispatch().prolong(now, arrived, walks);
                self.find_blocks_of(key).await?;
                self.work.send_replace(());
            }
            Ok(Outcome::Unwanted) => return Ok(Fate::Unwanted),
            Ok(Outcome::Before { records, new }) => return Ok(self.compare(arrived.by, key, records, new)),
            Ok(Outcome::Differs) => {
                drop(nothing_is_forgotten);
                self.distrust(arrived, &job).await?;
                return Ok(Fate::Conflict);
            }
            Err(error) => {
                drop(nothing_is_forgotten);
                if matches!(error, StoreError::Corrupt { table: "sums", .. }) {
                    self.forget_blocks(key, &job).await?;
                }
                return Err(error.into());
            }
        }
        Ok(Fate::Stored)
    }

    /// Other records are stored for the same walks, by a job of another dictionary: one of two workers has computed
    /// wrongly. Both jobs are done again, and then checked by others.
    async fn distrust(&self, arrived: &Arrived<'_>, job: &JobSpec) -> Result<(), StoreError> {
        let _no_result_on_its_way = self.records.write().await;
        let forgotten = self.store.forget_point(job.identity()).await?;
        self.store.forget_point(Digest::of_sums(job)).await?;
        self.dispatch().distrust(arrived, &forgotten);
        self.reopen(forgotten);
        self.find_blocks_of(arrived.key).await?;
        self.work.send_replace(());
        Ok(())
    }

    /// The blocks that came before a block were damaged when they were read. If they are at a second reading too, all
    /// are computed again.
    async fn forget_blocks(&self, key: &LeaseKey, job: &JobSpec) -> Result<(), StoreError> {
        let _no_result_on_its_way = self.records.write().await;
        let Some(what) = self.store.damaged_blocks(job).await? else {
            tracing::warn!(job = key.job, "stored blocks {UNSTEADY}: nothing was deleted");
            return Ok(());
        };
        self.store.forget_point(Digest::of_sums(job)).await?;
        self.find_blocks_of(key).await?;
        let name = self.dispatch().by_id(key.dictionary).map(|d| d.name().to_string()).unwrap_or_default();
        let event = Event::of_dictionary(EventKind::JobDamaged, key.dictionary, what);
        self.recorder.record(&name, &Event { job: Some(key.job), ..event });
        self.work.send_replace(());
        Ok(())
    }

    async fn find_blocks_of(&self, key: &LeaseKey) -> Result<(), StoreError> {
        let job = self.dispatch().by_id(key.dictionary).map(|d| d.spec(key.job, 0));
        if let Some(job) = job.filter(|job| job.block().is_some()) {
            let blocks = self.store.stored_blocks(&job).await?;
            self.dispatch().parts_stored(key.dictionary, key.job, job.walks(), &blocks);
        }
        Ok(())
    }

    fn compare(&self, by: Origin, key: &LeaseKey, stored: Digest, new: Digest) -> Fate {
        let mut dispatch = self.dispatch();
        let before = dispatch.checks();
        let equal = dispatch.compared(by, key, stored, new);
        let after = dispatch.checks();
        if after.0 > before.0 {
            self.metrics.verified(VerificationOutcome::Agreed);
        }
        if after.1 > before.1 {
            self.metrics.verified(VerificationOutcome::Disputed);
            // A third worker decides, which may be waiting for work.
            self.work.send_replace(());
        }
        if equal { Fate::Duplicate } else { Fate::Conflict }
    }

    fn note_store_fault(&self, error: Option<&StoreError>) {
        let mut fault = self.store_fault.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(error) = error
            && fault.is_none()
        {
            tracing::error!(%error, "results cannot be stored: workers keep them and try again");
        }
        if error.is_none() && fault.is_some() {
            tracing::info!("results can be stored again");
        }
        *fault = error.map(ToString::to_string);
    }
}
