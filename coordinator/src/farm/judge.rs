//! Computes what is to be checked, one part at a time on one thread, and acts on what that shows.
//!
//! The coordinator's own machine decides which of two results is right. The store notes the verdict before the dispatcher
//! does, so after a restart a check is either settled or made again.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Weak};
use std::time::Duration;

use optics_model::PackedRecords;
use optics_model::job::JobSpec;
use tokio::sync::oneshot;

use super::Farm;
use crate::dispatch::{Dictionary, PartId, Verdict};
use crate::recompute::Recompute;
use crate::store::{Exclusive, StoreError};
use crate::stored::{Completion, JobResult, Origin, Outcome};

/// Pause after a verdict that could not be stored.
const PAUSE: Duration = Duration::from_secs(10);

/// Checks results as long as the farm exists; `own` is the coordinator's machine.
pub(super) async fn judge(weak: Weak<Farm>, recompute: Recompute, own: Origin) {
    let name = |_| "judge".to_owned();
    let pool = match rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(name).build() {
        Ok(pool) => Arc::new(pool),
        Err(error) => return tracing::error!(%error, "results are not checked"),
    };
    let mut given_up = BTreeSet::new();
    while let Some(farm) = weak.upgrade() {
        let mut changes = farm.scheduler.changes();
        let next = farm.scheduler.query(|dispatcher, _| dispatcher.next_check(&given_up));
        drop(farm);
        let Some((part, job)) = next else {
            match changes.changed().await {
                Ok(()) => continue,
                Err(_) => return,
            }
        };
        let found = computed(&pool, recompute, job.clone()).await;
        let Some(farm) = weak.upgrade().filter(|farm| !farm.store.is_closed()) else { return };
        match found {
            Err(why) => {
                tracing::error!(?part, why, "a result cannot be checked");
                given_up.insert(part);
            }
            Ok(found) => {
                if let Err(error) = farm.judged(part, job, found, own).await
                    && !farm.store.is_closed()
                {
                    tracing::error!(%error, "a verdict could not be stored: it is tried again");
                    drop(farm);
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    }
}

async fn computed(pool: &rayon::ThreadPool, recompute: Recompute, job: JobSpec) -> Result<JobResult, String> {
    let (sender, receiver) = oneshot::channel();
    pool.spawn(move || {
        let found = catch_unwind(AssertUnwindSafe(|| recompute(&job)));
        let _ = sender.send(found.unwrap_or_else(|_| Err("the tracer panicked".to_owned())));
    });
    receiver.await.unwrap_or_else(|_| Err("its thread has ended".to_owned()))
}

impl Farm {
    /// Acts on a part that the coordinator has computed: machines with another result are fenced off, and a job that is
    /// without the right records gets them.
    async fn judged(
        &self,
        part: PartId,
        job: JobSpec,
        found: JobResult,
        own: Origin,
    ) -> Result<(), StoreError> {
        let exclusive = self.store.ledger().exclusive().await;
        let right = found.digest();
        let verdict = self.scheduler.query(|dispatcher, _| dispatcher.verdict(part, &job, right));
        let Some(mut verdict) = verdict else { return Ok(()) };
        verdict.wrong.retain(|machine| *machine != own);
        self.carry_out(&exclusive, &verdict, &job).await?;
        if let JobResult::Records(records) = found {
            self.keep(&exclusive, (part, &mut verdict), job, records, own).await?;
        }
        self.scheduler.transition(|dispatcher, _| dispatcher.settle(part, right, &verdict));
        self.scheduler.settled().await;
        Ok(())
    }

    /// Fences off the machines of a verdict, and has their results computed again that it does not confirm.
    async fn carry_out(
        &self,
        exclusive: &Exclusive<'_>,
        verdict: &Verdict,
        job: &JobSpec,
    ) -> Result<(), StoreError> {
        if verdict.wrong.is_empty() && !verdict.stored_is_wrong {
            return Ok(());
        }
        let both = [job.identity(), job.sums_identity()];
        let wrong = if verdict.stored_is_wrong { &both[..] } else { &[] };
        self.begin_again(exclusive, exclusive.fence(&verdict.wrong, &verdict.reason, wrong).await?);
        // Blocks of jobs that had not ended are gone too.
        let all =
            self.scheduler.query(|d, _| d.schedule().dictionaries().map(Dictionary::id).collect::<Vec<_>>());
        for id in all {
            self.find_blocks(exclusive, id).await?;
        }
        Ok(())
    }

    /// Notes that a job's records are verified, and stores them if it is open.
    async fn keep(
        &self,
        exclusive: &Exclusive<'_>,
        (part, verdict): (PartId, &mut Verdict),
        job: JobSpec,
        records: PackedRecords,
        own: Origin,
    ) -> Result<(), StoreError> {
        let ((dictionary, job_number), walks, identity) = (part.job_ref(), job.walks(), job.identity());
        let grid = self.scheduler.query(|d, _| d.schedule().by_id(dictionary).map(|d| d.grid().clone()));
        let completion = || Completion {
            dictionary,
            job_number,
            job: job.clone(),
            worker: own,
            content: JobResult::Records(records.clone()),
            quality: grid.as_ref().and_then(|grid| grid.quality()),
        };
        let mut outcome = exclusive.complete(completion()).await?;
        if outcome == Outcome::Differs {
            // The records of another job with the same walks are wrong.
            let others = self.store.jobs_of_point(identity).await?;
            let producers = self.scheduler.query(|d, _| d.schedule().producers(&others));
            verdict.wrong.extend(producers);
            verdict.stored_is_wrong = true;
            self.carry_out(exclusive, verdict, &job).await?;
            outcome = exclusive.complete(completion()).await?;
        }
        let (Outcome::Finished { records } | Outcome::Before { records, .. }) = outcome else {
            return Ok(());
        };
        self.store.note_verified(dictionary, job_number).await?;
        let served = self.scheduler.transition(|dispatcher, _| {
            dispatcher.verified((dictionary, job_number), walks, records, own);
            dispatcher.schedule().served_by((dictionary, job_number))
        });
        self.serve_others(exclusive, served, own).await;
        Ok(())
    }
}
