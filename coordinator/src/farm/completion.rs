//! Stores a result, or compares it with the stored one. The dispatcher notes the outcome under the ledger's guard.

use std::sync::PoisonError;

use farm_proto::ids::WorkerId;
use farm_proto::lease::LeaseKey;
use optics_model::Quality;
use optics_model::job::JobSpec;

use super::records::UNSTEADY;
use super::{Farm, Result};
use crate::dispatch::{Admission, Arrived, EventKind, JobRef};
use crate::store::{LedgerGuard, StoreError};
use crate::stored::{Completion, JobResult, Outcome};

/// The next step after a result is stored.
enum Next {
    Nothing,
    /// Look up which blocks of the job the store holds.
    FindBlocks,
    /// Try these jobs of other dictionaries, which the records may serve too.
    Serve(Vec<JobRef>),
}

impl Farm {
    /// Stores a result, or compares it with what is stored.
    pub(crate) async fn complete(
        &self,
        worker: WorkerId,
        key: LeaseKey,
        admission: Admission,
        result: JobResult,
    ) -> Result<Outcome> {
        let (walks, digest) = (admission.job().walks(), result.digest());
        let arrived = |by| Arrived { worker: &worker, by, key: &key, walks, digest };
        let outcome = match admission {
            Admission::Store { job, by, quality } => {
                self.store_result(&arrived(by), job, quality, result).await
            }
            Admission::Compare { by, stored, .. } => {
                let (arrived, outcome) = (arrived(by), Outcome::Before { records: stored, new: digest });
                self.scheduler.transition(|dispatcher, now| dispatcher.arrived(now, &arrived, outcome));
                Ok(outcome)
            }
            Admission::Repeated { .. } => Ok(Outcome::Repeated),
        };
        self.scheduler.settled().await;
        let outcome = outcome?;
        self.scheduler.metrics().job_completed(outcome.kind());
        Ok(outcome)
    }

    async fn store_result(
        &self,
        arrived: &Arrived<'_>,
        job: JobSpec,
        quality: Option<Quality>,
        content: JobResult,
    ) -> Result<Outcome> {
        let ((dictionary, job_number), key) = (arrived.job(), arrived.key);
        let (of, worker) = (job.clone(), arrived.by);
        let completion = Completion { dictionary, job_number, job, worker, content, quality };
        let shared = self.store.ledger().shared().await;
        let stored = shared.complete(completion).await;
        self.note_store_fault(stored.as_ref().err());
        if let Ok(outcome) = stored
            && outcome != Outcome::Differs
        {
            match self.note_outcome(arrived, outcome) {
                Next::Nothing => {}
                Next::FindBlocks => self.find_blocks_of(&shared, key).await?,
                Next::Serve(others) => self.serve_others(&shared, others, arrived.by).await,
            }
            return Ok(outcome);
        }
        drop(shared);
        match &stored {
            Ok(_) => self.distrust(arrived, &of).await?,
            Err(StoreError::Corrupt { table: "sums", .. }) => self.forget_blocks(key, &of).await?,
            Err(_) => {}
        }
        Ok(stored?)
    }

    /// Notes an outcome in the dispatcher, and returns the next step.
    fn note_outcome(&self, arrived: &Arrived<'_>, outcome: Outcome) -> Next {
        let job = arrived.job();
        self.scheduler.transition(|dispatcher, now| {
            dispatcher.arrived(now, arrived, outcome);
            let schedule = dispatcher.schedule();
            match outcome {
                Outcome::Finished { .. } => Next::Serve(schedule.served_by(job)),
                // Blocks are shared by dictionaries with the same jobs: another one may have merged blocks that this one
                // has counted.
                Outcome::Part if schedule.waits_for_nothing(job) => Next::FindBlocks,
                Outcome::MoreWalks(_) => Next::FindBlocks,
                _ => Next::Nothing,
            }
        })
    }

    /// Handles a result that differs from the stored records of another dictionary's job for the same walks: one of two
    /// machines has computed a wrong result. Blocks that were merged cannot be separated, so with them the other records
    /// go, too.
    async fn distrust(&self, arrived: &Arrived<'_>, job: &JobSpec) -> Result<(), StoreError> {
        let exclusive = self.store.ledger().exclusive().await;
        if job.block().is_some() {
            exclusive.delete_blocks(job).await?;
            let again = exclusive.delete_point(job.identity()).await?;
            self.begin_again(&exclusive, again);
        }
        self.scheduler.transition(|dispatcher, now| dispatcher.contradict(now, arrived));
        self.find_blocks_of(&exclusive, arrived.key).await
    }

    /// Handles blocks that were damaged when they were read for a merge. If a second reading finds them damaged too, all
    /// are computed again.
    async fn forget_blocks(&self, key: &LeaseKey, job: &JobSpec) -> Result<(), StoreError> {
        let exclusive = self.store.ledger().exclusive().await;
        let Some(what) = self.store.damaged_blocks(job).await? else {
            tracing::warn!(job = key.job, "stored blocks {UNSTEADY}: nothing was deleted");
            return Ok(());
        };
        exclusive.delete_blocks(job).await?;
        self.find_blocks_of(&exclusive, key).await?;
        self.scheduler.transition(|dispatcher, _| {
            dispatcher.note(key.dictionary, Some(key.job), EventKind::JobDamaged, what);
        });
        Ok(())
    }

    /// Notes in the dispatcher which blocks of a job the store holds.
    async fn find_blocks_of(&self, _held: &LedgerGuard<'_>, key: &LeaseKey) -> Result<(), StoreError> {
        let job = self.scheduler.query(|d, _| d.schedule().by_id(key.dictionary).map(|d| d.spec(key.job, 0)));
        if let Some(job) = job.filter(|job| job.block().is_some()) {
            let blocks = self.store.stored_blocks(&job).await?;
            self.scheduler.transition(|d, _| d.parts_stored((key.dictionary, key.job), job.walks(), &blocks));
        }
        Ok(())
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
