//! Combines the schedule, the verification of results and the roster of workers, and passes data between them.

use std::collections::BTreeSet;
use std::time::Duration;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::lease::{HeldLease, LeaseKey};
use farm_proto::status::{DictionaryStatus, JobState, WorkerStatus};
use optics_model::job::JobSpec;
use optics_model::{Digest, Walks};

use super::outbox::{Count, Effect, EventKind, Outbox};
use super::part::{JobRef, PartId};
use super::roster::{Registration, Roster};
use super::schedule::{Dictionary, LeaseRequest, Reason, Requester, Schedule};
use super::verification::{Verdict, Verification};
use super::{DispatchError, Grant, Settings, TokenSource};
use crate::stored::{DesiredState, OpenCheck, Origin};

/// All dictionaries, workers and leases of the farm.
#[derive(Debug)]
pub struct Dispatcher {
    settings: Settings,
    pub(super) schedule: Schedule,
    pub(super) verification: Verification,
    pub(super) roster: Roster,
    pub(super) outbox: Outbox,
    /// Effects that could not be performed.
    put_off: Vec<Effect>,
}

impl Dispatcher {
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            schedule: Schedule::new(settings),
            verification: Verification::new(settings),
            roster: Roster::new(settings),
            outbox: Outbox::default(),
            put_off: Vec::new(),
        }
    }

    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    pub fn verification(&self) -> &Verification {
        &self.verification
    }

    pub fn roster(&self) -> &Roster {
        &self.roster
    }

    /// The workers and machines, for changes that concern nothing else.
    pub fn roster_mut(&mut self) -> &mut Roster {
        &mut self.roster
    }

    pub fn status_of(&self, now: Duration, dictionary: &Dictionary) -> DictionaryStatus {
        let disputed = self.verification.disputed(dictionary.id()).len();
        self.schedule.status_of(now, dictionary, &self.roster, disputed)
    }

    /// The reasons why a dictionary is not done, the most important first.
    pub fn explain(&self, now: Duration, dictionary: &Dictionary) -> Vec<Reason> {
        let disputes = self.verification.explain(dictionary.id());
        self.schedule.explain(now, dictionary, &self.roster, disputes)
    }

    /// The states of all jobs of a dictionary, in their order; none if there is no such dictionary.
    pub fn job_states(&self, id: DictionaryId) -> Vec<JobState> {
        self.schedule.job_states(id)
    }

    /// Workers in the order of their ids, from the one after `after` on.
    pub fn workers(&self, now: Duration, after: &WorkerId, most: usize) -> Vec<WorkerStatus> {
        self.roster.statuses(now, after, most, |id| self.schedule.leases().count_of(id))
    }

    /// Checks the invariants of the state, after every transition of a debug build.
    #[cfg(debug_assertions)]
    pub fn check(&self, now: Duration) -> Result<(), String> {
        self.schedule.check(now, &self.roster)?;
        self.verification.check(&self.schedule)
    }

    /// Takes everything that the transitions since the last call have produced.
    pub fn take_outbox(&mut self) -> Outbox {
        let mut outbox = std::mem::take(&mut self.outbox);
        self.verification.publish(&mut outbox);
        outbox
    }

    /// Defers an effect that could not be performed: the next call of [`Self::look_over`] orders it again.
    pub fn put_off(&mut self, effect: Effect) {
        self.put_off.push(effect);
    }

    /// Records an event of a dictionary, or of one of its jobs, if the dictionary exists.
    pub fn note(&mut self, id: DictionaryId, job: Option<u32>, kind: EventKind, message: impl Into<String>) {
        self.schedule.note(id, job, kind, message, &mut self.outbox);
    }

    pub fn add_dictionary(&mut self, dictionary: Dictionary) {
        self.schedule.add(dictionary);
        self.outbox.work_came();
    }

    /// Adds a dictionary that workers may have been working on before the coordinator's start, which is time 0.
    pub fn take_up_dictionary(&mut self, dictionary: Dictionary) {
        self.schedule.expect_workers_of(dictionary.id());
        self.add_dictionary(dictionary);
    }

    pub fn remove_dictionary(&mut self, id: DictionaryId) {
        self.verification.hand_over(id, &self.schedule, &mut self.outbox);
        self.outbox.changed |= self.schedule.remove(id);
    }

    /// Sets the desired state of a dictionary; the store holds it already.
    pub fn set_desire(&mut self, id: DictionaryId, desire: DesiredState, reason: String) {
        let kind = match desire {
            DesiredState::Run => EventKind::Resumed,
            DesiredState::Pause => EventKind::Paused,
            DesiredState::Cancel => EventKind::Cancelled,
        };
        self.note(id, None, kind, reason.as_str());
        self.outbox.work_came();
        self.schedule.set_desire(id, desire, reason, &mut self.outbox);
    }

    pub fn set_priority(&mut self, id: DictionaryId, priority: i32) {
        self.schedule.set_priority(id, priority);
        self.note(id, None, EventKind::PriorityChanged, format!("priority {priority}"));
        self.outbox.changed = true;
    }

    /// Retries the jobs that were given up, and returns their number; the store has deleted their failures already.
    pub fn retry(&mut self, id: DictionaryId) -> usize {
        let again = self.schedule.retry(id);
        self.note(id, None, EventKind::Retried, format!("{again} jobs are tried again"));
        self.outbox.work_came();
        again
    }

    /// Restarts jobs whose records are no longer in the store.
    pub fn reopen(&mut self, id: DictionaryId, jobs: &[u32]) {
        self.schedule.reopen(id, jobs);
        self.verification.forget_jobs(id, jobs);
        self.outbox.work_came();
    }

    /// Notes which blocks of a divided job with this many walks the store holds, and that it holds no others.
    pub fn parts_stored(&mut self, (dictionary, job): JobRef, walks: Walks, stored: &BTreeSet<u32>) {
        if !self.schedule.has_blocks_of((dictionary, job), walks) {
            return;
        }
        for part in (0..walks.blocks()).map(|part| PartId { dictionary, job, part }) {
            if stored.contains(&part.part) {
                self.schedule.part_found(part, &mut self.outbox);
            } else {
                self.schedule.part_missing(part, &mut self.outbox);
                self.verification.forget_block(part);
            }
        }
    }

    /// Restores a check from the store.
    pub fn remember_check(&mut self, check: OpenCheck) {
        self.verification.remember(check, &self.schedule);
    }

    /// Registers a worker, and returns the duration of its leases. A process that registers again replaces its former
    /// registration.
    pub fn register(
        &mut self,
        now: Duration,
        id: WorkerId,
        machine: Origin,
        about: Registration,
    ) -> Result<Duration, DispatchError> {
        if let Some(before) = self.roster.register(now, id, machine, about, &mut self.outbox)? {
            // The process did not receive the answer to its first registration, or lost it: the parts that it held wait
            // again.
            self.schedule.free_worker(&before, &mut self.outbox);
        }
        Ok(self.settings.lease)
    }

    /// Notes a call of a worker, withdraws the blame for its silence, and returns its machine.
    pub(super) fn seen(&mut self, now: Duration, id: &WorkerId) -> Result<Origin, DispatchError> {
        let (process, blamed) = self.roster.seen(now, id)?;
        self.schedule.forgive(&process, blamed);
        Ok(self.roster.get(id)?.origin)
    }

    /// Removes a worker and frees all its leases, without blame.
    pub fn leave(&mut self, id: &WorkerId) {
        self.schedule.free_worker(id, &mut self.outbox);
        if let Some((process, blamed)) = self.roster.leave(id, &mut self.outbox) {
            self.schedule.forgive(&process, blamed);
        }
    }

    /// Marks a worker to finish the parts that it holds and then leave.
    pub fn drain(&mut self, which: &str) -> Result<WorkerId, String> {
        self.roster.drain(which, &mut self.outbox)
    }

    /// The part that the coordinator is to compute next for a check, except these; none if there is nothing to check.
    pub fn next_check(&self, except: &BTreeSet<PartId>) -> Option<(PartId, JobSpec)> {
        let workable = |part: PartId| self.schedule.by_id(part.dictionary).filter(|d| d.is_workable());
        let is_due = |part| !except.contains(&part) && workable(part).is_some_and(|d| d.job(part).is_some());
        let part = self.verification.next(is_due)?;
        Some((part, workable(part)?.spec(part.job, part.part)))
    }

    /// The verdict if the coordinator has computed this result of a part; none if the part is no longer checked, or has
    /// other walks now.
    pub fn verdict(&self, part: PartId, job: &JobSpec, right: Digest) -> Option<Verdict> {
        let dictionary = self.schedule.by_id(part.dictionary).filter(|d| d.job(part).is_some())?;
        let is_same = dictionary.spec(part.job, part.part).identity() == job.identity();
        self.verification.verdict(part, right, &self.schedule).filter(|_| is_same)
    }

    /// Ends a check with its verdict, which the store has noted: machines with another result are fenced off.
    pub fn settle(&mut self, part: PartId, right: Digest, verdict: &Verdict) {
        for machine in &verdict.wrong {
            if self.roster.fence(*machine, &verdict.reason, &mut self.outbox) {
                let workers: Vec<WorkerId> = self.roster.ids_of(*machine).cloned().collect();
                for worker in workers {
                    self.schedule.free_worker(&worker, &mut self.outbox);
                }
            }
        }
        self.verification.settle(part, right, &verdict.wrong, &mut self.outbox);
    }

    /// Grants as many parts as requested: the costliest jobs first, then copies of late parts.
    pub fn acquire(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        request: impl Into<LeaseRequest>,
        tokens: &mut impl TokenSource,
    ) -> Result<Grant, DispatchError> {
        let machine = self.seen(now, worker)?;
        let (schedule, roster) = (&mut self.schedule, &self.roster);
        if roster.get(worker)?.draining {
            return Ok(Grant { drain: true, ..Grant::default() });
        }
        let trial = roster.is_on_trial(machine);
        let busy = || roster.ids_of(machine).any(|id| schedule.leases().count_of(id) > 0);
        if roster.pause_left(now, machine).is_some() || trial && busy() {
            return Ok(Grant::default());
        }
        let request = if trial { LeaseRequest::from(request.into().parts.min(1)) } else { request.into() };
        let disputed: BTreeSet<JobRef> = self.verification.disputes().collect();
        let requester = Requester { worker, machine, roster, disputed: &disputed };
        let leases = schedule.grant(now, requester, request, tokens, &mut self.outbox);
        Ok(Grant { leases, drain: false })
    }

    /// Extends leases. Returns those that are lost, and whether the worker is to leave.
    pub fn renew(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        mut leases: Vec<HeldLease>,
    ) -> Result<(Vec<LeaseKey>, bool), DispatchError> {
        let machine = self.seen(now, worker)?;
        let holder = self.roster.access_token(machine);
        leases.retain(|lease| !self.schedule.renew(now, worker, holder, lease));
        Ok((leases.into_iter().map(|lease| lease.key).collect(), self.roster.get(worker)?.draining))
    }

    /// Takes leases back without blame; those that are not held are passed over.
    pub fn hand_back(&mut self, leases: &[LeaseKey]) {
        self.schedule.hand_back(leases, &mut self.outbox);
    }

    /// Performs the transitions that depend on time alone: frees leases, orders failed effects again, finds late parts,
    /// and removes workers that are gone. Returns the number of freed leases.
    pub fn look_over(&mut self, now: Duration) -> usize {
        let last = self.schedule.begin_look(now);
        self.try_effects_again();
        let freed = self.free_expired(now) + self.end_endless(now);
        // Wakes machines whose pause is over, and those that may now take parts that were reserved for others.
        if self.schedule.take_kept_for_others() | self.roster.pause_ended(last, now) {
            self.outbox.work_came();
        }
        self.schedule.find_late(now, &mut self.outbox);
        let leases = self.schedule.leases();
        self.roster.forget_silent(now, |id| leases.count_of(id) == 0, &mut self.outbox);
        freed
    }

    /// Orders failed effects again, as far as they still apply.
    fn try_effects_again(&mut self) {
        let schedule = &self.schedule;
        let holds = |effect: &Effect| match effect {
            Effect::GiveUp { dictionary, job, .. } => {
                schedule.by_id(*dictionary).is_some_and(|d| !d.is_open(*job))
            }
            Effect::NoteCheck(check) => schedule.by_id(check.dictionary).is_some(),
        };
        self.outbox.effects.extend(self.put_off.drain(..).filter(holds));
    }

    /// Frees leases past their deadline. A job that was being computed is blamed for its worker's silence, unless the worker
    /// was asked to stop before.
    fn free_expired(&mut self, now: Duration) -> usize {
        let expired = self.schedule.leases().expired(now);
        for token in &expired {
            let Some(held) = self.schedule.free(*token, &mut self.outbox) else { continue };
            let Ok(worker) = self.roster.get(&held.worker) else { continue };
            if !held.running || worker.stopping {
                continue;
            }
            let (label, process) = (self.roster.label_of(worker.origin), worker.about.instance.clone());
            self.roster.blamed(&held.worker, (held.key.dictionary, held.key.job));
            let what = format!("worker {label} fell silent while it computed this job");
            self.blame(now, &held, Some(process), &what);
        }
        self.count_expired(expired.len())
    }

    /// Frees leases that their workers keep renewing without ever delivering a result.
    fn end_endless(&mut self, now: Duration) -> usize {
        let endless = self.schedule.endless(now);
        for held in &endless {
            self.schedule.free(held.key.token, &mut self.outbox);
            let Ok(worker) = self.roster.get(&held.worker) else { continue };
            let (label, age) = (self.roster.label_of(worker.origin), now.saturating_sub(held.since));
            let what = format!("worker {label} had no result after {} s", age.as_secs());
            self.blame(now, held, None, &what);
        }
        self.count_expired(endless.len())
    }

    fn count_expired(&mut self, leases: usize) -> usize {
        if leases > 0 {
            self.outbox.counts.push(Count::Expired(leases));
            self.outbox.work_came();
        }
        leases
    }
}
