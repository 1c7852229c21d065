//! Which job goes to which worker: a state machine over plain data.
//!
//! Synchronous, and blind to clocks, randomness, network and store: time comes in as a monotonic [`Duration`],
//! randomness as a [`Chance`], results as calls. What must be made durable comes out as [`Effect`]s, what people may
//! want to know as [`Event`]s.

mod checks;
mod dictionary;
mod event;
mod explain;
mod job;
mod leases;
#[cfg(test)]
mod model_tests;
mod pace;
mod plan;
mod results;
#[cfg(test)]
mod tests;
mod workers;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::job::{Lease, LeaseKey};
use farm_proto::status::DictionaryStatus;
use farm_proto::{DictionaryName, Digest, Walks};

use crate::store::Desire;
use checks::Checks;
pub use checks::Origin;
pub use dictionary::Dictionary;
pub use event::{Effect, Event, EventKind};
pub use explain::Reason;
use job::Strike;
use leases::{Held, Leases};
pub use leases::{PartId, Purpose};
use pace::Pace;
pub use results::{Admission, Arrived};
pub use workers::Registration;
use workers::Workers;

/// A reaper that comes this much later than the time before was itself stopped: no worker is to blame for that.
const STALL: Duration = Duration::from_secs(5);

#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// How long a lease holds without a word from its worker.
    pub lease: Duration,
    /// Failed attempts after which a job is given up.
    pub max_attempts: u32,
    /// Share of the results that a second worker computes too, for comparison.
    pub check_share: f64,
}

/// Where randomness comes from.
pub trait Chance {
    /// A token that nobody can guess.
    fn token(&mut self) -> Token;
    /// A number from 0 to 1.
    fn share(&mut self) -> f64;
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DispatchError {
    #[error("worker {0} is not registered here: register again")]
    UnknownWorker(WorkerId),
    #[error("this worker is fenced off: {0}")]
    Fenced(String),
    #[error("lease of job {job} (attempt {attempt}) is no longer held: drop the result")]
    LeaseLost { job: u32, attempt: u32 },
    #[error("dictionary number {0} has no such job: drop the result")]
    UnknownJob(i64),
}

/// Leases that were given out, and whether the worker is to leave.
#[derive(Debug, Default)]
pub struct Grant {
    pub leases: Vec<Lease>,
    pub purposes: Vec<Purpose>,
    pub drain: bool,
}

/// All dictionaries, workers and leases of the farm.
#[derive(Debug)]
pub struct Dispatcher {
    settings: Settings,
    dictionaries: BTreeMap<DictionaryId, Dictionary>,
    /// Dictionaries in the order in which they are served.
    order: BTreeSet<(std::cmp::Reverse<i32>, DictionaryId)>,
    workers: Workers,
    leases: Leases,
    checks: Checks,
    pace: Pace,
    /// Parts that take too long, found at the last look.
    late: Vec<PartId>,
    /// Dictionaries that were begun before the coordinator's start.
    taken_up: BTreeSet<DictionaryId>,
    last_look: Option<Duration>,
    effects: Vec<Effect>,
    put_off: Vec<Effect>,
    events: Vec<Event>,
    jobs_done: u64,
}

impl Dispatcher {
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            dictionaries: BTreeMap::new(),
            order: BTreeSet::new(),
            workers: Workers::default(),
            leases: Leases::default(),
            checks: Checks::default(),
            pace: Pace::default(),
            late: Vec::new(),
            taken_up: BTreeSet::new(),
            last_look: None,
            effects: Vec::new(),
            put_off: Vec::new(),
            events: Vec::new(),
            jobs_done: 0,
        }
    }

    pub fn settings(&self) -> Settings {
        self.settings
    }

    pub fn add_dictionary(&mut self, dictionary: Dictionary) {
        self.order.insert((std::cmp::Reverse(dictionary.priority()), dictionary.id()));
        self.dictionaries.entry(dictionary.id()).or_insert(dictionary);
    }

    /// Takes up a dictionary that workers may have been working on before the coordinator's start, which is time 0.
    pub fn take_up_dictionary(&mut self, dictionary: Dictionary) {
        self.taken_up.insert(dictionary.id());
        self.add_dictionary(dictionary);
    }

    pub fn remove_dictionary(&mut self, id: DictionaryId) {
        if let Some(dictionary) = self.dictionaries.remove(&id) {
            self.order.remove(&(std::cmp::Reverse(dictionary.priority()), id));
            self.leases.remove_dictionary(id);
            self.checks.retain(|part| part.dictionary != id);
            self.late.retain(|part| part.dictionary != id);
            self.taken_up.remove(&id);
        }
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

    pub fn status(&self, now: Duration, name: &DictionaryName) -> Option<DictionaryStatus> {
        self.by_name(name).map(|dictionary| dictionary.status(self.eta_s(now, dictionary)))
    }

    pub fn statuses(&self, now: Duration) -> impl Iterator<Item = DictionaryStatus> {
        self.dictionaries.values().map(move |d| d.status(self.eta_s(now, d)))
    }

    /// Time until a dictionary is done at the present pace, with all that is served before it.
    pub fn eta_s(&self, now: Duration, dictionary: &Dictionary) -> Option<f64> {
        let rate = self.pace.rate(now)?;
        let first = (std::cmp::Reverse(dictionary.priority()), dictionary.id());
        let before = self.order.range(..first).filter_map(|(_, id)| self.dictionaries.get(id));
        let cost: f64 = before.filter(|d| d.is_active()).map(Dictionary::cost_left).sum();
        Some((cost + dictionary.cost_left()) / rate)
    }

    /// Parts that wait, and leases that are out.
    pub fn load(&self) -> (usize, usize) {
        let waiting = self.dictionaries.values().filter(|d| d.is_active()).map(Dictionary::pending).sum();
        (waiting, self.leases.len())
    }

    /// Jobs finished since the start.
    pub fn jobs_done(&self) -> u64 {
        self.jobs_done
    }

    /// Comparisons between workers: equal, unequal, and waiting for a worker.
    pub fn checks(&self) -> (u64, u64, usize) {
        (self.checks.agreed, self.checks.disputed, self.checks.waiting())
    }

    /// What must be made durable since the last call.
    pub fn take_effects(&mut self) -> Vec<Effect> {
        std::mem::take(&mut self.effects)
    }

    /// Effects that could not be performed come again with the next call of [`Self::expire`].
    pub fn put_off(&mut self, effects: Vec<Effect>) {
        self.put_off.extend(effects);
    }

    /// What has happened since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Gives out up to `max` parts: checks first, then the costliest of the dictionary that is served first, and when
    /// nothing waits any more, second copies of those that take too long.
    pub fn acquire(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        max: usize,
        chance: &mut impl Chance,
    ) -> Result<Grant, DispatchError> {
        self.seen(now, worker)?;
        let known = self.workers.get(worker)?;
        let origin = known.origin;
        if known.draining {
            return Ok(Grant { drain: true, ..Grant::default() });
        }
        let mut grant = Grant::default();
        let checks: Vec<PartId> =
            self.checks.open_to(origin).filter(|part| self.may_check(*part)).take(max).collect();
        for part in checks {
            self.grant(now, worker, part, Purpose::Check, chance, &mut grant);
        }
        let order: Vec<DictionaryId> = self.order.iter().map(|(_, id)| *id).collect();
        for id in order {
            // Workers that outlived a restart may have the costliest of these in hand, and have not said so yet.
            let returning = now < self.settings.lease && self.taken_up.contains(&id);
            while grant.leases.len() < max {
                let Some(dictionary) = self.dictionaries.get_mut(&id).filter(|d| d.is_active()) else {
                    break;
                };
                let Some((job, part, attempt)) = dictionary.take_next(returning) else { break };
                let purpose = if dictionary.is_retry(job) { Purpose::Retry } else { Purpose::First };
                dictionary.leased += 1;
                let part = PartId { dictionary: id, job, part };
                self.lease(now, worker, part, attempt, purpose, chance, &mut grant);
            }
        }
        while grant.leases.len() < max
            && let Some(part) = self.next_late(worker)
        {
            self.grant(now, worker, part, Purpose::Copy, chance, &mut grant);
        }
        Ok(grant)
    }

    fn may_check(&self, part: PartId) -> bool {
        let serves = |d: &Dictionary| d.job(part).is_some() && (d.is_active() || d.is_complete());
        self.dictionaries.get(&part.dictionary).is_some_and(serves)
            && self.leases.of_part(part).all(|held| held.purpose != Purpose::Check)
    }

    /// A part that takes too long, and is not this worker's own.
    fn next_late(&mut self, worker: &WorkerId) -> Option<PartId> {
        let served = |id| self.dictionaries.get(&id).is_some_and(Dictionary::is_active);
        let fits = |leases: &Leases, part: PartId| {
            // A part whose result is only checked any more is not late.
            let mut holders = leases.of_part(part);
            served(part.dictionary)
                && matches!((holders.next(), holders.next()), (Some(held), None) if held.purpose != Purpose::Check && held.worker != *worker)
        };
        let place = self.late.iter().position(|part| fits(&self.leases, *part))?;
        Some(self.late.swap_remove(place))
    }

    /// Gives out a part besides others.
    fn grant(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        part: PartId,
        purpose: Purpose,
        chance: &mut impl Chance,
        grant: &mut Grant,
    ) {
        if let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary) {
            let attempt = dictionary.attempt(part.job);
            self.lease(now, worker, part, attempt, purpose, chance, grant);
        }
    }

    #[expect(clippy::too_many_arguments, reason = "all of them describe one lease")]
    fn lease(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        id: PartId,
        attempt: u32,
        purpose: Purpose,
        chance: &mut impl Chance,
        grant: &mut Grant,
    ) {
        let PartId { dictionary, job, part } = id;
        let key = LeaseKey { dictionary, job, attempt, token: chance.token(), part };
        let deadline = now + self.settings.lease;
        let worker = worker.clone();
        self.leases.insert(Held { key, worker, purpose, since: now, deadline, running: false });
        grant.leases.push(Lease { key, job: self.dictionaries[&dictionary].spec(job, part) });
        grant.purposes.push(purpose);
    }

    /// Extends leases; tells which are lost, and whether the worker is to leave. A lease that is not known (the
    /// coordinator was restarted, or it had expired) is taken up again if its part still waits.
    pub fn renew(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        leases: Vec<(LeaseKey, bool, Digest)>,
    ) -> Result<(Vec<LeaseKey>, bool), DispatchError> {
        self.seen(now, worker)?;
        let drain = self.workers.get(worker)?.draining;
        let lost = leases
            .into_iter()
            .filter(|(key, running, identity)| !self.extend(now, worker, key, *running, *identity))
            .map(|(key, ..)| key)
            .collect();
        Ok((lost, drain))
    }

    fn extend(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        key: &LeaseKey,
        running: bool,
        identity: Digest,
    ) -> bool {
        let deadline = now + self.settings.lease;
        if let Some(held) = self.leases.get(key) {
            let own = held.worker == *worker;
            if own {
                self.leases.extend(key.token, deadline, running);
            }
            return own;
        }
        let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) else { return false };
        let wanted = !self.leases.has(key.token)
            && dictionary.job(PartId::from(key)).is_some()
            && dictionary.is_active()
            && dictionary.spec(key.job, key.part).identity() == identity;
        if !wanted || !dictionary.take(key.job, key.part, key.attempt) {
            return false;
        }
        dictionary.leased += 1;
        let worker = worker.clone();
        self.leases.insert(Held {
            key: *key,
            worker,
            purpose: Purpose::Retry,
            since: now,
            deadline,
            running,
        });
        true
    }

    /// Takes leases back without blame; those that are not held are passed over.
    pub fn hand_back(&mut self, leases: &[LeaseKey]) {
        for key in leases {
            if self.leases.get(key).is_some() {
                self.free(key.token);
            }
        }
    }

    /// Counts a failed attempt; the job is tried again or given up.
    pub fn failed(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        key: &LeaseKey,
        reason: &str,
    ) -> Result<(), DispatchError> {
        self.seen(now, worker)?;
        let origin = self.workers.get(worker)?.origin;
        let lost = DispatchError::LeaseLost { job: key.job, attempt: key.attempt };
        if self.leases.get(key).is_none_or(|held| held.worker != *worker) {
            return Err(lost);
        }
        let checked = self.free(key.token).is_some_and(|held| held.purpose == Purpose::Check);
        if !checked {
            let reason = format!("attempt {}: {reason}", key.attempt);
            self.strike(key, Strike { worker: Some(origin), silent: false, reason });
        }
        Ok(())
    }

    /// Ends one lease; its part waits again if nobody else holds it.
    fn free(&mut self, token: Token) -> Option<Held> {
        let held = self.leases.remove(token)?;
        if held.purpose == Purpose::Check {
            return Some(held);
        }
        let part = PartId::from(&held.key);
        let still_held = self.leases.of_part(part).any(|other| other.purpose != Purpose::Check);
        if let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary)
            && !still_held
        {
            dictionary.leased = dictionary.leased.saturating_sub(1);
            dictionary.put_back(part.job, part.part);
        }
        Some(held)
    }

    fn strike(&mut self, key: &LeaseKey, strike: Strike) {
        let (id, job) = (key.dictionary, key.job);
        let label = strike.worker.map(|origin| self.workers.label_of(origin)).unwrap_or_default();
        let Some(dictionary) = self.dictionaries.get_mut(&id) else { return };
        let event = |kind, message: String| Event {
            kind,
            dictionary: Some(id),
            job: Some(job),
            worker: label.clone(),
            message,
        };
        self.events.push(event(EventKind::AttemptFailed, strike.reason.clone()));
        if let Some((reason, quarantined)) = dictionary.strike(job, strike, self.settings.max_attempts) {
            let kind = if quarantined { EventKind::JobQuarantined } else { EventKind::JobFailed };
            self.events.push(event(kind, reason.clone()));
            self.effects.push(Effect::GiveUp { dictionary: id, job, reason, quarantined });
            self.end_leases_of_job(id, job);
        }
    }

    /// Ends the leases of all parts of a job.
    fn end_leases_of_job(&mut self, dictionary: DictionaryId, job: u32) {
        let blocks = self.dictionaries[&dictionary].spec(job, 0).walks().blocks();
        for part in 0..blocks {
            self.end_leases(PartId { dictionary, job, part });
        }
    }

    /// Ends the leases of a part that is computed no more, but for checks.
    fn end_leases(&mut self, part: PartId) -> Vec<Held> {
        let ended = self.leases.remove_part(part);
        let (checks, ended): (Vec<_>, Vec<_>) = ended.into_iter().partition(|h| h.purpose == Purpose::Check);
        for check in checks {
            self.leases.insert(check);
        }
        if !ended.is_empty()
            && let Some(dictionary) = self.dictionaries.get_mut(&part.dictionary)
        {
            dictionary.leased = dictionary.leased.saturating_sub(1);
        }
        ended
    }

    /// Frees leases past their deadline, looks for parts that take too long and forgets workers long gone; returns the
    /// number of leases freed. A job that was being computed is blamed for its worker's silence.
    pub fn expire(&mut self, now: Duration) -> usize {
        if let Some(last) = self.last_look.replace(now)
            && now.saturating_sub(last) > STALL
        {
            self.leases.postpone(now.saturating_sub(last));
        }
        let put_off = std::mem::take(&mut self.put_off);
        let holds = |effect: &Effect| match effect {
            Effect::GiveUp { dictionary, job, .. } => {
                self.by_id(*dictionary).is_some_and(|d| !d.is_open(*job))
            }
            Effect::Recompute { dictionary, .. } => self.dictionaries.contains_key(dictionary),
            Effect::Fence { .. } => true,
        };
        let again: Vec<_> = put_off.into_iter().filter(holds).collect();
        self.effects.extend(again);
        let expired = self.leases.expired(now);
        for token in &expired {
            let Some(held) = self.free(*token) else { continue };
            if held.running && held.purpose != Purpose::Check {
                let worker = self.workers.get(&held.worker).ok().map(|w| w.origin);
                let label = worker.map(|o| self.workers.label_of(o)).unwrap_or_default();
                let reason = format!(
                    "attempt {}: worker {label} fell silent while it computed this job",
                    held.key.attempt
                );
                if let Some(origin) = worker {
                    self.workers.silent(origin, (held.key.dictionary, held.key.job));
                }
                self.strike(&held.key, Strike { worker, silent: true, reason });
            }
        }
        self.find_late(now);
        let leases = &self.leases;
        for gone in self.workers.forget_silent(now, |id| leases.count_of(id) == 0) {
            self.events.push(Event::of_worker(EventKind::WorkerGone, gone, "not heard of any more"));
        }
        expired.len()
    }

    /// Looks for parts that take too long; worth doing only once nothing else waits.
    fn find_late(&mut self, now: Duration) {
        self.late.clear();
        if self.load().0 > 0 {
            return;
        }
        let late = self.leases.iter().filter(|held| {
            let part = PartId::from(&held.key);
            let cost =
                self.dictionaries.get(&part.dictionary).and_then(|d| d.job(part)).map(job::Job::part_cost);
            held.purpose != Purpose::Check
                && cost.is_some_and(|cost| self.pace.is_late(cost, now.saturating_sub(held.since)))
        });
        self.late = late.map(|held| PartId::from(&held.key)).collect();
    }

    /// Whether some parts take so long that second copies are wanted.
    pub fn wants_copies(&self) -> bool {
        !self.late.is_empty()
    }

    /// What people want of a dictionary; the store has it already.
    pub fn set_desire(&mut self, id: DictionaryId, desire: Desire, reason: String) {
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            dictionary.set_desire(desire, reason);
            if desire == Desire::Cancel {
                let held: Vec<Token> =
                    self.leases.iter().filter(|h| h.key.dictionary == id).map(|h| h.key.token).collect();
                for token in held {
                    self.free(token);
                }
            }
        }
    }

    pub fn set_priority(&mut self, id: DictionaryId, priority: i32) {
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            self.order.remove(&(std::cmp::Reverse(dictionary.priority()), id));
            dictionary.set_priority(priority);
            self.order.insert((std::cmp::Reverse(priority), id));
        }
    }

    /// Gives the jobs that were given up another chance; the store has forgotten their end.
    pub fn retry(&mut self, id: DictionaryId) -> usize {
        self.dictionaries.get_mut(&id).map_or(0, |d| d.retry().len())
    }

    /// Begins jobs again whose records are gone from the store.
    pub fn reopen(&mut self, id: DictionaryId, jobs: &[u32]) {
        for job in jobs {
            if self.dictionaries.contains_key(&id) {
                self.end_leases_of_job(id, *job);
            }
        }
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            dictionary.reopen(jobs);
        }
        self.checks.retain(|part| part.dictionary != id || !jobs.contains(&part.job));
    }

    /// Notes which blocks of a divided job of so many walks the store holds, and that it holds no others.
    pub fn parts_stored(&mut self, id: DictionaryId, job: u32, walks: Walks, stored: &BTreeSet<u32>) {
        let of_job = |d: &Dictionary| d.job(PartId { dictionary: id, job, part: 0 }).map(|j| j.walks);
        if self.by_id(id).and_then(of_job) != Some(walks) {
            return;
        }
        for part in 0..walks.blocks() {
            let whole = PartId { dictionary: id, job, part };
            if stored.contains(&part) {
                self.end_leases(whole);
            }
            let held = self.leases.of_part(whole).any(|held| held.purpose != Purpose::Check);
            if let Some(dictionary) = self.dictionaries.get_mut(&id) {
                if stored.contains(&part) {
                    dictionary.part_stored(job, part);
                } else {
                    dictionary.part_missing(job, part, held);
                }
            }
        }
    }

    fn seen(&mut self, now: Duration, id: &WorkerId) -> Result<(), DispatchError> {
        let origin = self.workers.seen(now, id)?;
        self.forgive(origin);
        Ok(())
    }

    /// A worker has been heard of: nothing failed for its silence.
    fn forgive(&mut self, origin: Origin) {
        for (dictionary, job) in self.workers.returned(origin) {
            if let Some(dictionary) = self.dictionaries.get_mut(&dictionary) {
                dictionary.forgive(job, origin);
            }
        }
    }
}
