//! Keeps the dictionaries with the states of their jobs and the open leases, and decides which job is granted next.

#[cfg(debug_assertions)]
mod check;
mod dictionary;
mod explain;
mod grant;
mod job;
mod job_states;
mod late;
mod lease_token;
mod leases;
mod pace;
mod pace_history;
mod plan;
mod progress;
mod results;
mod shared;
mod waiting;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use farm_proto::DictionaryName;
use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::LeaseKey;
use farm_proto::status::DictionaryStatus;

use super::Settings;
use super::outbox::{Count, Effect, Event, EventKind, Outbox};
use super::part::{JobRef, PartId};
use super::roster::Roster;
use crate::stored::{DesiredState, Origin};
pub use dictionary::Dictionary;
pub use explain::Reason;
pub use grant::{LeaseRequest, Requester};
#[cfg(test)]
pub use job::Part;
pub use job::{Done, Job, Stage, Strike};
#[cfg(test)]
pub use late::STALL;
pub use leases::{Leases, OpenLease};
use pace::Pace;
use pace_history::PaceHistory;
pub use pace_history::{PERIOD, Period};
pub use plan::Plan;

/// All dictionaries and leases of the farm.
#[derive(Debug)]
pub struct Schedule {
    settings: Settings,
    dictionaries: BTreeMap<DictionaryId, Dictionary>,
    /// Dictionaries in the order in which they are served.
    order: BTreeSet<(Reverse<i32>, DictionaryId)>,
    leases: Leases,
    pace: Pace,
    pace_history: PaceHistory,
    /// Parts that take too long, found at the last look.
    late: Vec<PartId>,
    /// Some part was reserved for other machines than the one that requested work.
    kept_for_others: bool,
    /// Dictionaries that were begun before the coordinator's start.
    taken_up: BTreeSet<DictionaryId>,
    last_look: Option<Duration>,
    jobs_done: u64,
}

impl Schedule {
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            dictionaries: BTreeMap::new(),
            order: BTreeSet::new(),
            leases: Leases::default(),
            pace: Pace::default(),
            pace_history: PaceHistory::default(),
            late: Vec::new(),
            kept_for_others: false,
            taken_up: BTreeSet::new(),
            last_look: None,
            jobs_done: 0,
        }
    }

    pub fn add(&mut self, dictionary: Dictionary) {
        let id = dictionary.id();
        self.order.insert((Reverse(dictionary.priority()), id));
        self.dictionaries.entry(id).or_insert(dictionary);
    }

    /// Notes that workers may have been working on a dictionary before the coordinator's start, which is time 0.
    pub fn expect_workers_of(&mut self, id: DictionaryId) {
        self.taken_up.insert(id);
    }

    /// Removes a dictionary with its leases; false if it does not exist.
    pub fn remove(&mut self, id: DictionaryId) -> bool {
        let Some(dictionary) = self.dictionaries.remove(&id) else { return false };
        self.order.remove(&(Reverse(dictionary.priority()), id));
        self.leases.remove_dictionary(id);
        self.late.retain(|part| part.dictionary != id);
        self.taken_up.remove(&id);
        true
    }

    pub fn dictionaries(&self) -> impl Iterator<Item = &Dictionary> {
        self.dictionaries.values()
    }

    pub fn by_id(&self, id: DictionaryId) -> Option<&Dictionary> {
        self.dictionaries.get(&id)
    }

    pub fn by_name(&self, name: &DictionaryName) -> Option<&Dictionary> {
        self.dictionaries.values().find(|d| d.name() == name)
    }

    pub fn job(&self, part: PartId) -> Option<&Job> {
        self.by_id(part.dictionary)?.job(part)
    }

    /// The machines that computed the stored results of jobs, as far as they are known.
    pub fn producers(&self, jobs: &[JobRef]) -> Vec<Origin> {
        let producer = |job: &JobRef| match self.job(PartId::first_of(*job))?.stage {
            Stage::Done(done) => done.by,
            _ => None,
        };
        jobs.iter().filter_map(producer).collect()
    }

    /// Notes that the stored records of a job are those that the coordinator has computed.
    pub fn set_verified(&mut self, (id, job): JobRef) {
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            dictionary.set_verified(job);
        }
    }

    pub fn leases(&self) -> &Leases {
        &self.leases
    }

    /// Dictionaries in the order in which they are served.
    pub fn order(&self) -> impl Iterator<Item = (Reverse<i32>, DictionaryId)> {
        self.order.iter().copied()
    }

    /// The status of a dictionary. `disputed`: jobs about which machines disagree.
    pub fn status_of(
        &self,
        now: Duration,
        dictionary: &Dictionary,
        roster: &Roster,
        disputed: usize,
    ) -> DictionaryStatus {
        let goes_first =
            || self.served_before(dictionary).find(|d| d.pending() > 0).map(|d| d.name().clone());
        let waits = dictionary.pending() > 0 && dictionary.leased() == 0 && dictionary.is_active();
        let eta_s = roster.active().next().and_then(|_| self.eta_s(now, dictionary));
        dictionary.status(eta_s, waits.then(goes_first).flatten(), disputed)
    }

    /// Active dictionaries that are served before this one, in this order.
    fn served_before(&self, dictionary: &Dictionary) -> impl Iterator<Item = &Dictionary> {
        let first = (Reverse(dictionary.priority()), dictionary.id());
        let before = self.order.range(..first).filter_map(|(_, id)| self.dictionaries.get(id));
        before.filter(|d| d.is_active())
    }

    /// Time until a dictionary is done at the present pace, with all that is served before it; None while the pace is
    /// not known.
    fn eta_s(&self, now: Duration, dictionary: &Dictionary) -> Option<f64> {
        let rate = self.pace.rate(now, self.leases.len())?;
        let before: f64 = self.served_before(dictionary).map(Dictionary::cost_left).sum();
        Some((before + dictionary.cost_left()) / rate)
    }

    /// Numbers of waiting parts and of open leases.
    pub fn load(&self) -> (usize, usize) {
        let waiting = self.dictionaries.values().filter(|d| d.is_active()).map(Dictionary::pending).sum();
        (waiting, self.leases.len())
    }

    /// Jobs finished since the start.
    pub fn jobs_done(&self) -> u64 {
        self.jobs_done
    }

    /// Jobs and costs finished in each period of the last hour, the oldest first; the last is not over.
    pub fn paces(&self, now: Duration) -> Vec<Period> {
        self.pace_history.periods(now)
    }

    /// Sets the desired state of a dictionary; the store holds it already.
    pub fn set_desire(
        &mut self,
        id: DictionaryId,
        desire: DesiredState,
        reason: String,
        outbox: &mut Outbox,
    ) {
        let Some(dictionary) = self.dictionaries.get_mut(&id) else { return };
        dictionary.set_desire(desire, reason);
        if desire == DesiredState::Cancel {
            let held = self.leases.iter().filter(|held| held.key.dictionary == id);
            for token in held.map(|held| held.key.token).collect::<Vec<_>>() {
                self.free(token, outbox);
            }
        }
    }

    pub fn set_priority(&mut self, id: DictionaryId, priority: i32) {
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            self.order.remove(&(Reverse(dictionary.priority()), id));
            dictionary.set_priority(priority);
            self.order.insert((Reverse(priority), id));
        }
    }

    /// Retries the jobs that were given up; returns their number.
    pub fn retry(&mut self, id: DictionaryId) -> usize {
        self.dictionaries.get_mut(&id).map_or(0, |d| d.retry().len())
    }

    /// Restarts jobs whose records are no longer in the store.
    pub fn reopen(&mut self, id: DictionaryId, jobs: &[u32]) {
        if !self.dictionaries.contains_key(&id) {
            return;
        }
        for job in jobs {
            self.end_leases_of_job((id, *job));
        }
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            dictionary.reopen(jobs);
        }
    }

    /// Records an event of a dictionary, or of one of its jobs, if the dictionary exists.
    pub fn note(
        &self,
        id: DictionaryId,
        job: Option<u32>,
        kind: EventKind,
        message: impl Into<String>,
        outbox: &mut Outbox,
    ) {
        if let Some(dictionary) = self.by_id(id) {
            outbox.events.push(Event { job, ..Event::of_dictionary(kind, dictionary.name(), message) });
        }
    }

    /// Withdraws the blame of jobs for the silence of a process.
    pub fn forgive(&mut self, process: &str, jobs: Vec<JobRef>) {
        for (id, job) in jobs {
            if let Some(dictionary) = self.dictionaries.get_mut(&id) {
                dictionary.forgive(job, process);
            }
        }
    }

    /// Takes leases back without blame; those that are not held are passed over.
    pub fn hand_back(&mut self, leases: &[LeaseKey], outbox: &mut Outbox) {
        for key in leases {
            if self.leases.get(key).is_some() {
                self.free(key.token, outbox);
            }
        }
    }

    /// Takes all leases of a worker back without blame.
    pub fn free_worker(&mut self, worker: &WorkerId, outbox: &mut Outbox) {
        for token in self.leases.of_worker(worker) {
            self.free(token, outbox);
        }
    }

    /// Ends one lease; its part waits again if no other lease holds it.
    pub fn free(&mut self, token: Token, outbox: &mut Outbox) -> Option<OpenLease> {
        let held = self.leases.remove(token)?;
        let part = PartId::from(&held.key);
        if let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary)
            && !self.leases.is_part_held(part)
        {
            dictionary.lease_ended();
            dictionary.put_back(part.job, part.part);
            outbox.work_came();
        }
        Some(held)
    }

    /// Ends the leases of all parts of a job.
    fn end_leases_of_job(&mut self, job: JobRef) {
        for part in self.leases.parts_of_job(job) {
            self.end_leases(part);
        }
    }

    /// Ends the leases of a part that is no longer to be computed.
    fn end_leases(&mut self, part: PartId) -> Vec<OpenLease> {
        let ended = self.leases.remove_part(part);
        if !ended.is_empty()
            && let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary)
        {
            dictionary.lease_ended();
        }
        ended
    }

    /// Counts a failed attempt at a job, which is tried again or given up. Returns the number of machines that have
    /// failed at it.
    pub fn strike(
        &mut self,
        now: Duration,
        (id, job): JobRef,
        strike: Strike,
        roster: &Roster,
        outbox: &mut Outbox,
    ) -> usize {
        let Some(dictionary) = self.dictionaries.get_mut(&id) else { return 0 };
        let (name, label) = (dictionary.name().clone(), roster.label_of(strike.machine));
        let able: BTreeSet<Origin> = roster.able(now).collect();
        let no_other = |job: &Job| able.iter().all(|machine| job.is_struck_by(*machine));
        let given_up = dictionary.strike(job, strike.clone(), self.settings.max_attempts, no_other);
        let machines_struck = dictionary.jobs.get(job as usize).map_or(0, Job::machines_struck);
        let event = |kind, message: String| Event::of_job(kind, &name, job, message).by(label.as_str());
        outbox.events.push(event(EventKind::AttemptFailed, strike.reason));
        outbox.changed = true;
        if let Some((reason, quarantined)) = given_up {
            let kind = if quarantined { EventKind::JobQuarantined } else { EventKind::JobFailed };
            outbox.counts.push(Count::GivenUp { quarantined });
            outbox.events.push(event(kind, reason.clone()));
            outbox.effects.push(Effect::GiveUp { dictionary: id, job, reason, quarantined });
            self.end_leases_of_job((id, job));
        }
        machines_struck
    }
}
