//! Ends jobs with records that were computed for another dictionary. It runs under the ledger's guard.

use farm_proto::ids::DictionaryId;
use optics_model::Digest;
use optics_model::job::JobSpec;

use super::Farm;
use crate::dispatch::JobRef;
use crate::store::{LedgerGuard, StoreError};
use crate::stored::Origin;

impl Farm {
    /// Ends jobs of other dictionaries that the records of a job serve too.
    pub(super) async fn serve_others(&self, held: &LedgerGuard<'_>, served: Vec<JobRef>, by: Origin) {
        for (id, job) in served {
            // If this fails, the job is computed by itself.
            if let Err(error) = self.take_over(held, id, &[job], Some(by)).await {
                tracing::warn!(%error, job, "a job could not be ended with the records of another dictionary");
            }
        }
    }

    /// Ends the open jobs of a dictionary whose records came for others.
    pub(super) async fn take_over_done(
        &self,
        held: &LedgerGuard<'_>,
        id: DictionaryId,
    ) -> Result<(), StoreError> {
        let done = self.scheduler.query(|dispatcher, _| dispatcher.schedule().done_elsewhere(id));
        if done.is_empty() { Ok(()) } else { self.take_over(held, id, &done, None).await }
    }

    async fn take_over(
        &self,
        held: &LedgerGuard<'_>,
        id: DictionaryId,
        jobs: &[u32],
        by: Option<Origin>,
    ) -> Result<(), StoreError> {
        let found = self.scheduler.query(|dispatcher, _| {
            let dictionary = dispatcher.schedule().by_id(id)?;
            let specs: Vec<(u32, JobSpec)> =
                jobs.iter().map(|job| (*job, dictionary.spec(*job, 0))).collect();
            let grids = dispatcher.schedule().dictionaries().map(|d| (d.id(), d.grid().clone())).collect();
            Some((dictionary.grid().clone(), specs, grids))
        });
        let Some((grid, specs, grids)) = found else { return Ok(()) };
        let identities: Vec<(u32, Digest)> =
            specs.iter().map(|(job, spec)| (*job, spec.identity())).collect();
        let taken = held.reuse(id, &grid, &identities, &grids).await?;
        self.scheduler.transition(|dispatcher, _| {
            for (job, records) in &taken {
                dispatcher.taken_over((id, *job), grid.walks_of(*job as usize), *records, by);
            }
        });
        let is_taken = |job: u32| taken.iter().any(|(taken, _)| *taken == job);
        for (_, spec) in specs.iter().filter(|(job, spec)| spec.block().is_some() && is_taken(*job)) {
            // The blocks of the job are no longer needed.
            held.delete_blocks(spec).await?;
        }
        Ok(())
    }
}
