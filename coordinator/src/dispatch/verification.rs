//! Verifies results: a share of them is computed by a second machine too, a third decides when two differ, and a machine
//! that is outvoted is fenced off.
//!
//! Only a machine that was given a check has a vote. Any other result that differs from the stored one opens a check, and
//! decides nothing: a worker that once held a lease could deliver for it any number of times.

mod checks;
mod sampling;
mod verdicts;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use farm_proto::ids::DictionaryId;
use farm_proto::status::JobState;
use optics_model::Digest;

use super::Settings;
use super::admission::Arrived;
use super::outbox::{Effect, Event, EventKind, Outbox};
use super::part::{JobRef, PartId};
use super::roster::Roster;
use super::schedule::{Dictionary, Reason, Schedule, Stage};
use crate::stored::{OpenCheck, Origin, Vote};
use checks::{Checks, is_disputed};

/// The checks that are open, and the results that have passed one.
#[derive(Debug)]
pub struct Verification {
    settings: Settings,
    checks: Checks,
    /// Jobs whose next result is checked in any case.
    suspects: BTreeSet<JobRef>,
    /// Machines that have confirmed the stored result of a job, besides the one that computed it.
    confirmed: BTreeMap<JobRef, Vec<Origin>>,
}

/// The state that verification acts on: the jobs, the machines, and the decisions to be published.
#[derive(Debug)]
pub struct Context<'a> {
    pub schedule: &'a mut Schedule,
    pub roster: &'a mut Roster,
    pub outbox: &'a mut Outbox,
}

impl Context<'_> {
    fn note_difference(&mut self, by: Origin, part: PartId, message: impl Into<String>) {
        if let Some(dictionary) = self.schedule.by_id(part.dictionary) {
            let event = Event::of_job(EventKind::ResultsDiffer, dictionary.name(), part.job, message);
            self.outbox.events.push(event.by(self.roster.label_of(by)));
        }
    }
}

impl Verification {
    pub fn new(settings: Settings) -> Self {
        Self { settings, checks: Checks::default(), suspects: BTreeSet::new(), confirmed: BTreeMap::new() }
    }

    /// Samples the results that a dictionary begins with, and records which of them were confirmed.
    pub fn add_dictionary(
        &mut self,
        id: DictionaryId,
        confirmed: Vec<(u32, Vec<Origin>)>,
        schedule: &Schedule,
    ) {
        self.confirmed.extend(confirmed.into_iter().map(|(job, by)| ((id, job), by)));
        let unchecked = schedule.unchecked(id, |part, digest| {
            self.is_sampled(part, digest) && !self.confirmed.contains_key(&part.job_ref())
        });
        for (part, first) in unchecked {
            self.checks.want(part, vec![first], false);
        }
    }

    /// Hands the open checks of a removed dictionary over to another one that shares the records of its jobs.
    pub fn hand_over(&mut self, id: DictionaryId, schedule: &Schedule, outbox: &mut Outbox) {
        let open: Vec<_> =
            self.checks.of_dictionary(id).map(|(part, votes)| (part, votes.to_vec())).collect();
        for (part, votes) in open {
            let Some((heir, records)) = schedule.heir(part) else { continue };
            let first = votes[0];
            // If the heir holds other albedos of the same walks, the votes of others do not apply to its records.
            let same = first.digest == records;
            let votes = if same { votes } else { vec![Vote { by: first.by, digest: records }] };
            self.checks.want(heir, votes, true);
            outbox.work = true;
        }
    }

    pub fn forget_dictionary(&mut self, id: DictionaryId) {
        self.checks.forget_dictionary(id);
        self.confirmed.retain(|(dictionary, _), _| *dictionary != id);
        self.suspects.retain(|(dictionary, _)| *dictionary != id);
    }

    /// Drops the checks and confirmations of jobs whose records are gone.
    pub fn forget_jobs(&mut self, id: DictionaryId, jobs: &[u32]) {
        self.checks.retain(|part| part.dictionary != id || !jobs.contains(&part.job));
        for job in jobs {
            self.checks.forget_aside((id, *job));
            self.confirmed.remove(&(id, *job));
        }
    }

    /// Drops the checks of the blocks of a job that is begun again with more walks.
    pub fn forget_blocks(&mut self, job: JobRef) {
        self.checks.retain(|part| part.job_ref() != job);
    }

    /// Drops the check of a block that is no longer stored.
    pub fn forget_block(&mut self, part: PartId) {
        self.checks.settle(part);
    }

    /// Resumes the check of a block that is stored again; false if the store holds no such check.
    pub fn block_found(&mut self, part: PartId) -> bool {
        self.checks.take_up(part)
    }

    /// Requests a check of a stored block if it is sampled, or if its job is suspect.
    pub fn block_stored(&mut self, arrived: &Arrived, outbox: &mut Outbox) {
        let is_suspect = self.suspects.contains(&arrived.job());
        self.want_check_of_block(arrived, is_suspect, outbox);
    }

    /// Requests a check of a finished job if its result is sampled, or if the job is suspect.
    pub fn job_finished(&mut self, arrived: &Arrived, records: Digest, outbox: &mut Outbox) {
        let (job, part) = (arrived.job(), arrived.part());
        self.checks.forget_aside(job);
        self.confirmed.remove(&job);
        let is_suspect = self.suspects.remove(&job);
        if arrived.walks.blocks() > 1 {
            self.want_check_of_block(arrived, is_suspect, outbox);
        } else if is_suspect || self.is_sampled(part, records) {
            self.checks.want(part, vec![Vote { by: Some(arrived.by), digest: records }], is_suspect);
            outbox.work = true;
        }
    }

    /// Notes that a job is done with the records of another one.
    pub fn job_taken_over(&mut self, job: JobRef) {
        self.suspects.remove(&job);
        self.checks.forget_aside(job);
    }

    /// Requests a check of a block. Its sums are merged and cannot be recovered later, so the store keeps their digest.
    fn want_check_of_block(&mut self, arrived: &Arrived, is_suspect: bool, outbox: &mut Outbox) {
        let Arrived { by, digest, .. } = *arrived;
        if is_suspect || self.is_sampled(arrived.part(), digest) {
            self.checks.want(arrived.part(), vec![Vote { by: Some(by), digest }], true);
            outbox.work = true;
        }
    }

    fn is_sampled(&self, part: PartId, digest: Digest) -> bool {
        sampling::is_sampled(&self.settings.secret, part, digest, self.settings.check_share)
    }

    /// Marks jobs whose next results are checked in any case.
    pub fn suspect(&mut self, jobs: impl IntoIterator<Item = JobRef>) {
        self.suspects.extend(jobs);
    }

    /// Whether several machines agree on the records of one of these jobs.
    pub fn is_confirmed(&self, jobs: &[JobRef]) -> bool {
        jobs.iter().any(|job| self.confirmed.contains_key(job))
    }

    /// Parts that a machine may check: those about which it has no vote yet. `is_own` is true for machines that share its
    /// vote.
    pub fn open_to(&self, is_own: impl Fn(Origin) -> bool) -> impl Iterator<Item = PartId> {
        self.checks.open_to(is_own)
    }

    /// The digest of the stored result of a part that is being checked.
    pub fn subject(&self, part: PartId) -> Option<Digest> {
        self.checks.subject(part)
    }

    /// Numbers of comparisons between machines: equal, unequal, and waiting for a worker.
    pub fn counts(&self) -> (u64, u64, usize) {
        (self.checks.agreed, self.checks.disputed, self.checks.waiting())
    }

    /// The checks of a dictionary that are open, with their votes.
    pub fn of_dictionary(&self, id: DictionaryId) -> impl Iterator<Item = (PartId, &[Vote])> {
        self.checks.of_dictionary(id)
    }

    /// Jobs of a dictionary about which machines disagree.
    pub fn disputed(&self, id: DictionaryId) -> usize {
        let mut jobs: Vec<u32> = self.checks.disputed_in(id).map(|part| part.job).collect();
        jobs.dedup();
        jobs.len()
    }

    /// Marks the jobs of a dictionary that are done and were confirmed.
    pub fn mark_checked(&self, id: DictionaryId, states: &mut [JobState]) {
        for ((_, job), by) in self.confirmed.range((id, 0)..=(id, u32::MAX)) {
            if !by.is_empty()
                && let Some(state @ JobState::Done) = states.get_mut(*job as usize)
            {
                *state = JobState::Checked;
            }
        }
    }

    /// The reasons that concern the checks of a dictionary: disputes, and checks that no machine can take.
    pub fn explain(&self, now: Duration, id: DictionaryId, roster: &Roster) -> Vec<Reason> {
        let mut reasons = Vec::new();
        if let Some(PartId { job, .. }) = self.checks.disputed_in(id).next() {
            let count = self.disputed(id);
            let text = format!(
                "machines disagree about {count} jobs, the first is job {job}: one that has not computed it must decide"
            );
            reasons.push(Reason::new("DISPUTED", text));
        }
        let able: Vec<Origin> = roster.able(now).collect();
        let has_voted = |machine: Origin, votes: &[Vote]| {
            votes.iter().any(|vote| vote.by.is_some_and(|by| roster.share_a_vote(machine, by)))
        };
        let stuck =
            |votes: &[Vote]| !is_disputed(votes) && able.iter().all(|machine| has_voted(*machine, votes));
        let count = self.checks.of_dictionary(id).filter(|(_, votes)| stuck(votes)).count();
        if count > 0 {
            let results = if count == 1 { "1 result is".to_owned() } else { format!("{count} results are") };
            let text = format!(
                "{results} not checked: a check needs a second machine, and nothing else waits for it"
            );
            reasons.push(Reason::new("CHECKS_WAIT", text));
        }
        reasons
    }

    /// Verifies the invariants of the checks, of which there are a thousand at most.
    #[cfg(debug_assertions)]
    pub fn check(&self, schedule: &Schedule) -> Result<(), String> {
        for (part, votes) in self.checks.all() {
            let by: Vec<Origin> = votes.iter().filter_map(|vote| vote.by).collect();
            let is_one_each = by.iter().collect::<BTreeSet<_>>().len() == by.len();
            if votes.is_empty() || !is_one_each || schedule.by_id(part.dictionary).is_none() {
                return Err(format!("{part:?} is checked with the votes {votes:?}"));
            }
        }
        let gone =
            self.confirmed.iter().find(|(job, by)| schedule.records_of(**job).is_none() || by.is_empty());
        gone.map_or(Ok(()), |(job, by)| Err(format!("{job:?} has no records, and {by:?} confirm them")))
    }

    /// Orders the store to note the checks that have changed.
    pub fn publish(&mut self, outbox: &mut Outbox) {
        for (PartId { dictionary, job, part }, votes) in self.checks.take_changed() {
            outbox.effects.push(Effect::NoteCheck(OpenCheck { dictionary, job, block: part, votes }));
            outbox.changed = true;
        }
    }

    /// Restores a check from the store, if it still concerns the stored result.
    pub fn remember(&mut self, check: OpenCheck, schedule: &Schedule) {
        let part = PartId { dictionary: check.dictionary, job: check.job, part: check.block };
        let first = check.votes.first().map(|first| first.digest);
        let holds = schedule.job(part).is_some_and(|job| {
            job.is_divided() || matches!(job.stage, Stage::Done { records, .. } if first == Some(records))
        });
        let goes_on = |d: &Dictionary| d.grid().quality().is_some() && !d.is_done(part.job);
        if !holds && schedule.by_id(part.dictionary).is_some_and(goes_on) {
            // With more walks the job may have this block again.
            self.checks.put_aside(part, check.votes);
            return;
        }
        self.checks.remember(part, check.votes);
        if !holds {
            // The store notes that it is over.
            self.checks.settle(part);
        }
    }
}
