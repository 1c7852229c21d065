//! Which job goes to which worker: a state machine over plain data.
//!
//! Synchronous, and blind to clocks, randomness, network and store: time comes in as a monotonic [`Duration`],
//! tokens from a [`TokenSource`], results as calls. What comes of it – what must be made durable, what people may want
//! to know, whom to wake – is in the [`Outbox`].

mod arrivals;
mod blame;
mod checks;
mod dictionary;
mod explain;
mod grant;
mod job;
mod job_states;
mod judgement;
mod lease_mac;
mod leases;
mod look_over;
mod machines;
#[cfg(test)]
mod model_tests;
mod outbox;
mod pace;
mod pace_history;
mod plan;
mod progress;
mod shared;
#[cfg(test)]
mod tests;
mod waiting;
mod workers;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use farm_proto::DictionaryName;
use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::Lease;
use farm_proto::status::DictionaryStatus;
use optics_model::Walks;

use crate::stored::{DesiredState, OpenCheck, Origin, Secret};
pub use arrivals::{Admission, Arrived, Next};
use checks::Checks;
pub use dictionary::Dictionary;
pub use explain::Reason;
pub use grant::Wish;
use lease_mac::LeaseMac;
use leases::Leases;
pub use leases::{PartId, Purpose};
pub use outbox::{Count, Effect, Event, EventKind, Outbox};
use pace::Pace;
use pace_history::PaceHistory;
pub use pace_history::{PERIOD, Period};
pub use plan::Plan;
pub use shared::JobRef;
pub use workers::Registration;
use workers::Workers;

#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// How long a lease holds without a word from its worker.
    pub lease: Duration,
    /// Failed attempts after which a job is given up.
    pub max_attempts: u32,
    /// Share of the results that a second worker computes too, for comparison.
    pub check_share: f64,
    /// What decides which these are, and marks leases as given by this coordinator.
    pub secret: Secret,
}

/// Where tokens of leases come from.
pub trait TokenSource {
    /// A token that nobody can guess.
    fn token(&mut self) -> Token;
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DispatchError {
    #[error("worker {0} is not registered here: register again")]
    UnknownWorker(WorkerId),
    #[error("this worker is fenced off: {0}")]
    Fenced(String),
    #[error("lease of job {job} (attempt {attempt}) is no longer held: drop the result")]
    LeaseLost { job: u32, attempt: u32 },
    #[error(
        "{most} workers with this token are registered already: give some a token of their own (farmctl access add)"
    )]
    ManyWorkers { most: usize },
    #[error("dictionary number {0} has no such job: drop the result")]
    UnknownJob(i64),
}

/// Leases that were given out, and whether the worker is to leave.
#[derive(Debug, Default)]
pub struct Grant {
    pub leases: Vec<Lease>,
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
    /// Jobs whose next result is checked in any case.
    suspects: BTreeSet<(DictionaryId, u32)>,
    /// Who has found the same as is stored of a job, besides who computed it.
    confirmed: BTreeMap<JobRef, Vec<Origin>>,
    pace: Pace,
    pace_history: PaceHistory,
    /// Parts that take too long, found at the last look.
    late: Vec<PartId>,
    /// Some part was kept for other machines than the one that asked.
    kept_for_others: bool,
    /// Dictionaries that were begun before the coordinator's start.
    taken_up: BTreeSet<DictionaryId>,
    last_look: Option<Duration>,
    outbox: Outbox,
    /// Effects that could not be performed.
    put_off: Vec<Effect>,
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
            suspects: BTreeSet::new(),
            confirmed: BTreeMap::new(),
            pace: Pace::default(),
            pace_history: PaceHistory::default(),
            late: Vec::new(),
            kept_for_others: false,
            taken_up: BTreeSet::new(),
            last_look: None,
            outbox: Outbox::default(),
            put_off: Vec::new(),
            jobs_done: 0,
        }
    }

    pub fn settings(&self) -> Settings {
        self.settings
    }

    fn mac(&self) -> LeaseMac {
        LeaseMac(self.settings.secret)
    }

    pub fn add_dictionary(&mut self, mut dictionary: Dictionary) {
        let id = dictionary.id();
        let confirmed = std::mem::take(&mut dictionary.confirmed).into_iter();
        self.confirmed.extend(confirmed.map(|(job, by)| ((id, job), by)));
        self.order.insert((std::cmp::Reverse(dictionary.priority()), id));
        self.dictionaries.entry(id).or_insert(dictionary);
        self.want_checks(id);
        self.work_came();
    }

    /// Takes up a dictionary that workers may have been working on before the coordinator's start, which is time 0.
    pub fn take_up_dictionary(&mut self, dictionary: Dictionary) {
        self.taken_up.insert(dictionary.id());
        self.add_dictionary(dictionary);
    }

    pub fn remove_dictionary(&mut self, id: DictionaryId) {
        self.hand_over_checks(id);
        if let Some(dictionary) = self.dictionaries.remove(&id) {
            self.order.remove(&(std::cmp::Reverse(dictionary.priority()), id));
            self.leases.remove_dictionary(id);
            (0..dictionary.jobs() as u32).for_each(|job| self.checks.forget_aside(id, job));
            self.checks.retain(|part| part.dictionary != id);
            self.confirmed.retain(|(dictionary, _), _| *dictionary != id);
            self.suspects.retain(|(dictionary, _)| *dictionary != id);
            self.late.retain(|part| part.dictionary != id);
            self.taken_up.remove(&id);
            self.outbox.changed = true;
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
        self.by_name(name).map(|dictionary| self.status_of(now, dictionary))
    }

    pub fn status_of(&self, now: Duration, dictionary: &Dictionary) -> DictionaryStatus {
        let goes_first =
            || self.served_before(dictionary).find(|d| d.pending() > 0).map(|d| d.name().clone());
        let waits = dictionary.pending() > 0 && dictionary.leased == 0 && dictionary.is_active();
        let disputed = self.disputed(dictionary.id());
        dictionary.status(self.eta_s(now, dictionary), waits.then(goes_first).flatten(), disputed)
    }

    /// Active dictionaries that are served before this one, the first first.
    fn served_before(&self, dictionary: &Dictionary) -> impl Iterator<Item = &Dictionary> {
        let first = (std::cmp::Reverse(dictionary.priority()), dictionary.id());
        let before = self.order.range(..first).filter_map(|(_, id)| self.dictionaries.get(id));
        before.filter(|d| d.is_active())
    }

    /// Time until a dictionary is done at the present pace, with all that is served before it; None while there is no
    /// pace to tell it from.
    fn eta_s(&self, now: Duration, dictionary: &Dictionary) -> Option<f64> {
        self.workers.active().next()?;
        let rate = self.pace.rate(now, self.leases.len())?;
        let before: f64 = self.served_before(dictionary).map(Dictionary::cost_left).sum();
        Some((before + dictionary.cost_left()) / rate)
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

    /// What was finished in each period of the last hour, the oldest first; the last is not over.
    pub fn paces(&self, now: Duration) -> Vec<Period> {
        self.pace_history.periods(now)
    }

    /// Comparisons between workers: equal, unequal, and waiting for a worker.
    pub fn checks(&self) -> (u64, u64, usize) {
        (self.checks.agreed, self.checks.disputed, self.checks.waiting())
    }

    /// All that came of the changes since the last call.
    pub fn take_outbox(&mut self) -> Outbox {
        let mut outbox = std::mem::take(&mut self.outbox);
        for (PartId { dictionary, job, part }, votes) in self.checks.take_changed() {
            let check = OpenCheck { dictionary, job, block: part, votes };
            outbox.effects.push(Effect::NoteCheck(check));
            outbox.changed = true;
        }
        outbox
    }

    /// There may be work for a worker that waits, and people may see something new.
    fn work_came(&mut self) {
        self.outbox.work = true;
        self.outbox.changed = true;
    }

    /// An effect that could not be performed comes again with the next call of [`Self::look_over`].
    pub fn put_off(&mut self, effect: Effect) {
        self.put_off.push(effect);
    }

    /// Says of all events since the last look into the outbox who has brought them about.
    pub fn tell_who(&mut self, actor: &str) {
        self.outbox.events.iter_mut().for_each(|event| actor.clone_into(&mut event.actor));
    }

    /// Notes an event of a dictionary, if it is there.
    pub fn tell(&mut self, id: DictionaryId, kind: EventKind, message: impl Into<String>) {
        if let Some(dictionary) = self.dictionaries.get(&id) {
            self.outbox.events.push(Event::of_dictionary(kind, dictionary.name(), message));
        }
    }

    /// What people want of a dictionary; the store has it already.
    pub fn set_desire(&mut self, id: DictionaryId, desire: DesiredState, reason: String) {
        let kind = match desire {
            DesiredState::Run => EventKind::Resumed,
            DesiredState::Pause => EventKind::Paused,
            DesiredState::Cancel => EventKind::Cancelled,
        };
        self.tell(id, kind, reason.as_str());
        self.work_came();
        if let Some(dictionary) = self.dictionaries.get_mut(&id) {
            dictionary.set_desire(desire, reason);
            if desire == DesiredState::Cancel {
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
        self.tell(id, EventKind::PriorityChanged, format!("priority {priority}"));
        self.outbox.changed = true;
    }

    /// Gives the jobs that were given up another chance; the store has forgotten their end.
    pub fn retry(&mut self, id: DictionaryId) -> usize {
        let again = self.dictionaries.get_mut(&id).map_or(0, |d| d.retry().len());
        self.tell(id, EventKind::Retried, format!("{again} jobs are tried again"));
        self.work_came();
        again
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
        for job in jobs {
            self.checks.forget_aside(id, *job);
            self.confirmed.remove(&(id, *job));
        }
        self.work_came();
    }

    /// Tells that what was stored of a job was damaged.
    pub fn tell_damage(&mut self, id: DictionaryId, job: u32, what: &str) {
        if let Some(dictionary) = self.dictionaries.get(&id) {
            self.outbox.events.push(Event::of_job(EventKind::JobDamaged, dictionary.name(), job, what));
        }
    }

    /// Notes which blocks of a divided job of so many walks the store holds, and that it holds no others.
    pub fn parts_stored(&mut self, id: DictionaryId, job: u32, walks: Walks, stored: &BTreeSet<u32>) {
        let of_job = |d: &Dictionary| d.job(PartId { dictionary: id, job, part: 0 }).map(|j| j.walks);
        let known = self.by_id(id).filter(|d| d.too_large.is_none());
        if known.and_then(of_job) != Some(walks) {
            return;
        }
        for part in 0..walks.blocks() {
            let whole = PartId { dictionary: id, job, part };
            if stored.contains(&part) {
                self.outbox.changed |= !self.end_leases(whole).is_empty();
            }
            let held = self.leases.of_part(whole).any(|held| held.purpose != Purpose::Check);
            let Some(dictionary) = self.dictionaries.get_mut(&id) else { return };
            if stored.contains(&part) {
                let news = dictionary.part_stored(job, part);
                self.outbox.changed |= news;
                self.outbox.work |= news && self.checks.take_up(whole);
            } else {
                let waits = dictionary.part_missing(job, part, held);
                self.checks.settle(whole);
                if waits {
                    self.work_came();
                }
            }
        }
    }

    /// A worker has been heard of: nothing failed for its silence.
    fn seen(&mut self, now: Duration, id: &WorkerId) -> Result<(), DispatchError> {
        let (process, blamed) = self.workers.seen(now, id)?;
        for (dictionary, job) in blamed {
            if let Some(dictionary) = self.dictionaries.get_mut(&dictionary) {
                dictionary.forgive(job, &process);
            }
        }
        Ok(())
    }
}
