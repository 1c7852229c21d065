//! Implements the operations of clients and admins: submit, pause, resume, cancel, retry, delete, explain, drain. Changes
//! of dictionaries run one at a time.

use std::collections::HashSet;

use farm_proto::DictionaryName;
use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::status::{DictionaryState, DictionaryStatus, FailedJob};
use optics_model::{Digest, Grid};

use super::{Farm, FarmError, Result, blocking, named};
use crate::actor::Actor;
use crate::clock::Clock;
use crate::dispatch::{Dictionary, EventKind, Plan, Reason};
use crate::quota::Limit;
use crate::store::{LedgerGuard, StoreError, StoredEvent};
use crate::stored::{DesiredState, StoredDictionary};

/// Most jobs and waiting parts of all dictionaries together, and of those that one token has submitted. A million is
/// some 100 MB.
const ENTRIES: u64 = 20_000_000;
const ENTRIES_OF_ONE: u64 = 8_000_000;
/// Most dictionaries of one token.
const DICTIONARIES_OF_ONE: u64 = 2000;

impl Farm {
    /// Creates a dictionary, or finds the one of the same name and grid. Records that exist already are used.
    pub(crate) async fn submit(
        &self,
        by: &Actor,
        name: DictionaryName,
        grid: Grid,
        priority: i32,
    ) -> Result<DictionaryStatus> {
        let _one_at_a_time = self.managing.lock().await;
        let existing = self.scheduler.query(|d, _| d.schedule().by_name(&name).map(Dictionary::grid_digest));
        if let Some(existing) = existing {
            if existing == Digest::of_grid(&grid) {
                return self.status(&name);
            }
            return Err(FarmError::NameTaken { name });
        }
        grid.check_parts()?;
        // A dictionary for which there is no room in memory must not be stored, since the next start would load it.
        let planned = grid.clone();
        let plan = blocking(move || Plan::new(&planned)).await;
        self.check_room(by, &plan)?;
        let stored =
            self.store.create_dictionary(name.clone(), grid, priority, by.name(), Clock::unix_ms()).await?;
        let id = stored.id;
        if let Err(error) = self.take_up(by, plan, stored).await {
            // A dictionary that is stored and not served would keep its name for ever.
            self.scheduler.transition(|dispatcher, _| dispatcher.remove_dictionary(id));
            let exclusive = self.store.ledger().exclusive().await;
            if let Err(error) = exclusive.delete_dictionary(id, &[]).await {
                tracing::error!(%error, %name, "a dictionary that was not taken up could not be deleted");
            }
            return Err(error);
        }
        self.status(&name)
    }

    /// Checks the limits for a new dictionary. The coordinator keeps account of every job of every dictionary: all
    /// together have a limit, and those of one token leave room for others. The disk keeps room for results, too.
    fn check_room(&self, by: &Actor, plan: &Plan) -> Result<()> {
        let (what, delete) = ("jobs and waiting blocks, which take memory,", "delete dictionaries");
        let (mut count, mut own, mut all) = (0, 0, 0);
        self.scheduler.query(|dispatcher, _| {
            for dictionary in dispatcher.schedule().dictionaries() {
                let entries = dictionary.entries() as u64;
                all += entries;
                if dictionary.owner() == by.name() {
                    (count, own) = (count + 1, own + entries);
                }
            }
        });
        let more = plan.entries() as u64;
        Limit::all_callers(ENTRIES).check(all, more, what, delete)?;
        if !by.shares_as().is_empty() {
            Limit::new(by.key(), ENTRIES_OF_ONE).check(own, more, what, delete)?;
            Limit::new(by.key(), DICTIONARIES_OF_ONE).check(count, 1, "dictionaries", "delete some")?;
        }
        Ok(self.store.check_room(0)?)
    }

    /// Begins to serve a new dictionary; jobs whose records exist already are done.
    async fn take_up(&self, by: &Actor, plan: Plan, stored: StoredDictionary) -> Result<()> {
        let (id, grid) = (stored.id, stored.grid.clone());
        let shared = self.store.ledger().shared().await;
        let reused = if grid.quality().is_some() {
            // The final number of walks of a point is not known in advance.
            0
        } else {
            let of_jobs = grid.clone();
            let jobs = blocking(move || identities(&of_jobs)).await;
            let grids = self
                .scheduler
                .query(|d, _| d.schedule().dictionaries().map(|d| (d.id(), d.grid().clone())).collect());
            shared.reuse(id, &grid, &jobs, &grids).await?.len()
        };
        let ended = self.store.ended_jobs(id, &grid).await?;
        let dictionary = Dictionary::planned(plan, stored, &ended);
        self.scheduler.transition(|dispatcher, _| dispatcher.add_dictionary(dictionary));
        self.find_blocks(&shared, id).await?;
        // Records may have arrived in the meantime.
        self.take_over_done(&shared, id).await?;
        let (jobs, records) = (grid.job_count(), grid.stored_records());
        let message = format!("{jobs} jobs, {records} records; {reused} jobs are there already");
        self.scheduler
            .transition_by(by, |dispatcher, _| dispatcher.note(id, None, EventKind::Submitted, message));
        Ok(())
    }

    /// Notes in the dispatcher which blocks of divided jobs the store holds.
    pub(super) async fn find_blocks(
        &self,
        _held: &LedgerGuard<'_>,
        id: DictionaryId,
    ) -> Result<(), StoreError> {
        let wanted = self
            .scheduler
            .query(|d, _| d.schedule().by_id(id).map_or_else(Vec::new, Dictionary::divided_jobs));
        for (job, spec) in wanted {
            let blocks = self.store.stored_blocks(&spec).await?;
            self.scheduler.transition(|d, _| d.parts_stored((id, job), spec.walks(), &blocks));
        }
        Ok(())
    }

    pub(crate) async fn pause(&self, by: &Actor, name: &DictionaryName) -> Result<DictionaryStatus> {
        self.change(by, name, DesiredState::Pause, "", &[DictionaryState::Running, DictionaryState::Paused])
            .await
    }

    pub(crate) async fn resume(&self, by: &Actor, name: &DictionaryName) -> Result<DictionaryStatus> {
        let from = [DictionaryState::Paused, DictionaryState::Cancelled, DictionaryState::Running];
        self.change(by, name, DesiredState::Run, "", &from).await
    }

    pub(crate) async fn cancel(
        &self,
        by: &Actor,
        name: &DictionaryName,
        reason: &str,
    ) -> Result<DictionaryStatus> {
        let from = [DictionaryState::Running, DictionaryState::Paused, DictionaryState::Cancelled];
        self.change(by, name, DesiredState::Cancel, reason, &from).await
    }

    /// The dictionary of a name, if the actor may change it.
    fn changeable(&self, by: &Actor, name: &DictionaryName) -> Result<DictionaryStatus> {
        let status = self.status(name)?;
        if by.may_change(&status.owner) {
            return Ok(status);
        }
        Err(FarmError::NotYours { name: name.clone(), owner: status.owner })
    }

    async fn change(
        &self,
        by: &Actor,
        name: &DictionaryName,
        desire: DesiredState,
        reason: &str,
        from: &[DictionaryState],
    ) -> Result<DictionaryStatus> {
        let _one_at_a_time = self.managing.lock().await;
        let status = self.changeable(by, name)?;
        if !from.contains(&status.state()) {
            let allowed = match desire {
                DesiredState::Run => {
                    "only one that is paused or cancelled can be resumed; `retry` is for failed jobs"
                }
                DesiredState::Pause => "only one that is running can be paused",
                DesiredState::Cancel => "only one that is running or paused can be cancelled",
            };
            return Err(FarmError::WrongState {
                name: name.clone(),
                state: status.state().as_str(),
                allowed,
            });
        }
        let (id, grid) = self.found(name)?;
        if desire == DesiredState::Run {
            grid.check_parts()?;
        }
        self.store.set_desire(id, desire, reason).await?;
        self.scheduler
            .transition_by(by, |dispatcher, _| dispatcher.set_desire(id, desire, reason.to_owned()));
        if desire == DesiredState::Run {
            let shared = self.store.ledger().shared().await;
            self.take_over_done(&shared, id).await?;
        }
        self.status(name)
    }

    pub(crate) async fn retry(&self, by: &Actor, name: &DictionaryName) -> Result<DictionaryStatus> {
        let _one_at_a_time = self.managing.lock().await;
        self.changeable(by, name)?;
        let (id, _) = self.found(name)?;
        self.store.retry_jobs(id).await?;
        self.scheduler.transition_by(by, |dispatcher, _| dispatcher.retry(id));
        let shared = self.store.ledger().shared().await;
        self.find_blocks(&shared, id).await?;
        self.take_over_done(&shared, id).await?;
        self.status(name)
    }

    pub(crate) async fn set_priority(
        &self,
        by: &Actor,
        name: &DictionaryName,
        priority: i32,
    ) -> Result<DictionaryStatus> {
        let _one_at_a_time = self.managing.lock().await;
        self.changeable(by, name)?;
        let (id, _) = self.found(name)?;
        self.store.set_priority(id, priority).await?;
        self.scheduler.transition_by(by, |dispatcher, _| dispatcher.set_priority(id, priority));
        self.status(name)
    }

    /// Removes a dictionary that does not run; returns the number of records that were deleted with it.
    pub(crate) async fn delete(&self, by: &Actor, name: &DictionaryName) -> Result<u64> {
        let _one_at_a_time = self.managing.lock().await;
        let state = self.changeable(by, name)?.state();
        if state.is_open() {
            let allowed = "cancel it before it is deleted";
            return Err(FarmError::WrongState { name: name.clone(), state: state.as_str(), allowed });
        }
        let (id, _) = self.found(name)?;
        let exclusive = self.store.ledger().exclusive().await;
        let blocks = self.blocks_of_none_but(id);
        let records = exclusive.delete_dictionary(id, &blocks).await?;
        self.scheduler.transition_by(by, |dispatcher, _| {
            dispatcher.note(id, None, EventKind::Deleted, format!("{records} records deleted"));
            dispatcher.remove_dictionary(id);
        });
        self.fits.forget(id);
        Ok(records)
    }

    /// Identities of the points that gather blocks of this dictionary's unfinished jobs, and of no other dictionary's.
    fn blocks_of_none_but(&self, id: DictionaryId) -> Vec<Digest> {
        let gathered = |d: &Dictionary| d.divided_jobs().into_iter().map(|(_, job)| job.sums_identity());
        self.scheduler.query(|dispatcher, _| {
            let others = dispatcher.schedule().dictionaries().filter(|d| d.id() != id);
            let others: HashSet<Digest> = others.flat_map(gathered).collect();
            let own = dispatcher.schedule().by_id(id).into_iter().flat_map(gathered);
            own.filter(|digest| !others.contains(digest)).collect()
        })
    }

    pub(crate) fn explain(&self, name: &DictionaryName) -> Result<Vec<Reason>> {
        let mut reasons =
            self.scheduler.query(|d, now| Ok::<_, FarmError>(d.explain(now, named(d, name)?)))?;
        if let Some(fault) = self.store_fault() {
            let text = format!("results cannot be stored: {fault}; workers keep them and try again");
            reasons.insert(0, Reason { code: "STORE_FAULT", text });
        }
        if let Some(text) = self.results.shortage() {
            reasons.insert(0, Reason { code: "NO_ROOM", text });
        }
        Ok(reasons)
    }

    pub(crate) fn drain(&self, by: &Actor, which: &str) -> Result<WorkerId> {
        let drained = self.scheduler.transition_by(by, |dispatcher, _| dispatcher.drain(which));
        drained.map_err(|why| FarmError::Worker { which: which.to_owned(), why })
    }

    /// Jobs of a dictionary that were given up, from the index `from` on.
    pub(crate) fn failed_jobs(
        &self,
        name: &DictionaryName,
        from: u32,
        most: usize,
    ) -> Result<Vec<FailedJob>> {
        self.scheduler.query(|d, _| Ok(named(d, name)?.given_up(from, most)))
    }

    /// Events with a number above `after`, those before the question included.
    pub(crate) async fn events(&self, after: i64, dictionary: &str, most: u32) -> Result<Vec<StoredEvent>> {
        self.scheduler.settle_events().await;
        Ok(self.store.events_after(after, dictionary, most).await?)
    }

    /// The last events, those before the question included.
    pub(crate) async fn newest_events(&self, dictionary: &str, most: u32) -> Result<Vec<StoredEvent>> {
        self.scheduler.settle_events().await;
        Ok(self.store.newest_events(dictionary, most).await?)
    }
}

/// All jobs of a grid, with their identities.
fn identities(grid: &Grid) -> Vec<(u32, Digest)> {
    use optics_model::job::JobSpec;
    (0..grid.job_count()).map(|job| (job as u32, JobSpec::of(grid, job).identity())).collect()
}
