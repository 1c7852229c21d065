//! Models the farm around the dispatcher: its store, its workers, and the steps.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use farm_proto::ids::{DictionaryId, Token, WorkerId};
use farm_proto::lease::{Lease, LeaseKey};
use farm_proto::status::DictionaryState;
use optics_model::Walks;
use optics_model::job::JobSpec;

use super::ops::Op;
use super::store::ModelStore;
use crate::dispatch::schedule::STALL;
use crate::dispatch::tests::Counted;
use crate::dispatch::{Dictionary, Dispatcher, JobRef, PartId, Settings};
use crate::stored::{DesiredState, Machine, Origin, Secret};

pub const LEASE: Duration = Duration::from_secs(8);
pub const MAX_ATTEMPTS: u32 = 2;
pub const WORKERS: usize = 5;
const DICTIONARIES: usize = 4;

/// The machine of a failed attempt, and the process if its silence was the reason.
pub type Struck = (Origin, Option<String>);

/// A worker's process.
#[derive(Debug, Clone)]
pub struct Process {
    pub instance: String,
    pub machine: Machine,
    pub origin: Origin,
    pub id: WorkerId,
    pub held: Vec<Lease>,
    /// Leases that it no longer holds, whose results may still arrive.
    pub old: Vec<Lease>,
    pub wrong: bool,
}

/// A result that was admitted and not stored yet.
#[derive(Debug)]
pub struct Arriving {
    pub worker: WorkerId,
    pub by: Origin,
    pub key: LeaseKey,
    pub job: JobSpec,
}

pub struct World {
    pub farm: Dispatcher,
    pub store: ModelStore,
    pub processes: Vec<Process>,
    pub now: Duration,
    pub settings: Settings,
    /// Failed attempts of open jobs.
    pub strikes: BTreeMap<(DictionaryId, u32), Vec<Struck>>,
    /// Walks of jobs that were begun again with more.
    pub walks: BTreeMap<(DictionaryId, u32), Walks>,
    pub arriving: Vec<Arriving>,
    /// The part that the coordinator computes itself at present.
    pub judging: Option<(PartId, JobSpec)>,
    pub chance: Counted,
    pub tokens: BTreeSet<Token>,
    pub origins: BTreeMap<WorkerId, Origin>,
    pub instances: BTreeMap<WorkerId, String>,
    pub draining: BTreeSet<WorkerId>,
    last_look: Option<Duration>,
    pub numbers: i64,
    /// Whether waiting workers were woken in this step, and watching clients.
    pub woken: (bool, bool),
    /// The first violation within a step.
    pub complaint: Option<String>,
}

impl World {
    pub fn new(wrong: usize, check_share: f64) -> Self {
        let secret = Secret([5; 32]);
        let settings = Settings { lease: LEASE, max_attempts: MAX_ATTEMPTS, check_share, secret };
        let mut world = Self {
            farm: Dispatcher::new(settings),
            store: ModelStore::default(),
            processes: Vec::new(),
            now: Duration::ZERO,
            settings,
            strikes: BTreeMap::new(),
            walks: BTreeMap::new(),
            arriving: Vec::new(),
            judging: None,
            chance: Counted { tokens: 0 },
            tokens: BTreeSet::new(),
            origins: BTreeMap::new(),
            instances: BTreeMap::new(),
            draining: BTreeSet::new(),
            last_look: None,
            numbers: 0,
            woken: (false, false),
            complaint: None,
        };
        for i in 0..WORKERS {
            // The last two are on one machine.
            let together = (i == WORKERS - 1).then(|| world.processes[i - 1].origin);
            let process = world.process(i < wrong, together);
            world.processes.push(process);
            world.register(i);
        }
        world.submit(0);
        world.submit(1);
        world
    }

    /// A new process, on the given machine or on a new one.
    pub fn process(&mut self, wrong: bool, on: Option<Origin>) -> Process {
        self.numbers += 1;
        let origin = on.unwrap_or(Origin(self.numbers));
        if wrong {
            self.store.wrong.insert(origin);
        }
        let machine = Machine { address: format!("{}", origin.0), ..Machine::default() };
        let (instance, id) = (format!("p{}", self.numbers), WorkerId(String::new()));
        Process { instance, machine, origin, id, held: Vec::new(), old: Vec::new(), wrong }
    }

    pub fn insist(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds && self.complaint.is_none() {
            self.complaint = Some(what());
        }
    }

    /// The numbers of parts that a waiting worker could get, and of checks for the coordinator.
    fn offers(&self) -> (usize, usize) {
        let disputed: BTreeSet<JobRef> = self.farm.verification.disputes().collect();
        let active = self.farm.schedule.dictionaries().filter(|d| d.is_active());
        let jobs = active.flat_map(|d| (0..d.jobs() as u32).map(move |job| (d, job)));
        let parts = jobs.filter(|(d, job)| !disputed.contains(&(d.id(), *job)));
        let parts = parts.flat_map(|(d, job)| d.open_parts(job).into_iter().map(move |part| (d, job, part)));
        let parts = parts.filter(|(d, job, part)| d.waits(*job, *part)).count();
        (parts, self.farm.verification.counts().2)
    }

    /// The states of the dictionaries as clients see them.
    fn seen(&self) -> Vec<(DictionaryId, DictionaryState, (usize, usize))> {
        self.farm.schedule.dictionaries().map(|d| (d.id(), d.state(), d.ended())).collect()
    }

    /// Performs a step, and checks the wake-ups: calls that wait for work or changes must be woken when there are some,
    /// since they are not repeated before.
    pub fn step(&mut self, op: &Op) {
        let (offers, seen) = (self.offers(), self.seen());
        self.woken = (false, false);
        self.perform(op);
        self.settle();
        let (now, woken) = (self.offers(), self.woken);
        self.insist((woken.0 || now.0 <= offers.0) && (woken.1 || now.1 <= offers.1), || {
            format!("new work is not signalled: {offers:?} before, now {now:?}")
        });
        let same = seen == self.seen();
        self.insist(woken.1 || same, || "a change is not signalled".to_owned());
    }

    fn perform(&mut self, op: &Op) {
        match *op {
            Op::Register(worker) => self.register(worker),
            Op::Acquire(worker, max) => self.acquire(worker, max),
            Op::Renew(worker, which, running) => self.renew(worker, which, running),
            Op::Forge(worker, lease, how) => self.forge(worker, lease, how),
            Op::Deliver(worker, lease) => {
                self.begin(worker, lease);
                self.end(usize::MAX);
            }
            Op::Begin(worker, lease) => self.begin(worker, lease),
            Op::End(which) => self.end(which),
            Op::Clash(which, with) => self.clash(which, with),
            Op::DeliverOld(worker, lease) => self.deliver_old(worker, lease),
            Op::DeliverAlien(worker, lease) => self.deliver_alien(worker, lease),
            Op::Fail(worker, lease) => self.fail(worker, lease),
            Op::HandBack(worker, lease) => {
                if let Some(lease) = self.take_lease(worker, lease) {
                    self.farm.hand_back(&[lease.key]);
                }
            }
            Op::Leave(worker) => self.leave(worker),
            Op::Drain(worker) => {
                let id = self.processes[worker].id.clone();
                if self.farm.drain(&id.0).is_ok() {
                    self.draining.insert(id);
                }
            }
            Op::Die(worker) => self.begin_anew(worker),
            Op::Expire(tenths) => self.expire(Duration::from_millis(100 * tenths)),
            Op::Stall(seconds) => self.expire(Duration::from_secs(seconds)),
            Op::Judge => self.judge(),
            Op::Restart => self.restart(),
            Op::Submit(kind) => self.submit(kind),
            Op::Pause(at) => self.set_desire(at, DesiredState::Pause),
            Op::Resume(at) => self.set_desire(at, DesiredState::Run),
            Op::Cancel(at) => self.set_desire(at, DesiredState::Cancel),
            Op::Priority(at, to) => self.with(at, |world, id| {
                world.store.dictionaries.get_mut(&id).unwrap().priority = to;
                world.farm.set_priority(id, to);
            }),
            Op::Retry(at) => self.with(at, Self::retry),
            Op::Delete(at) => self.delete(at),
            Op::Damage(at, job) => self.with(at, |world, id| world.recompute(id, job)),
        }
    }

    fn with(&mut self, at: usize, act: impl FnOnce(&mut Self, DictionaryId)) {
        if let Some(id) = self.dictionary(at) {
            act(self, id);
        }
    }

    fn dictionary(&self, at: usize) -> Option<DictionaryId> {
        self.store.dictionaries.keys().nth(at).copied()
    }

    pub fn origin(&self, id: &WorkerId) -> Option<Origin> {
        self.origins.get(id).copied()
    }

    /// Replaces a process by a new one on another machine; the leases of the old one are not ended.
    pub fn replace(&mut self, worker: usize, wrong: bool) {
        self.processes[worker] = self.process(wrong, None);
    }

    /// Replaces a process by a new one on the same machine.
    pub fn begin_anew(&mut self, worker: usize) {
        let Process { origin, wrong, .. } = self.processes[worker];
        self.processes[worker] = self.process(wrong, Some(origin));
    }

    pub fn walks_of(&self, place: (DictionaryId, u32)) -> u64 {
        let of_grid = self.store.dictionaries[&place.0].grid.walks_of(0);
        self.walks.get(&place).copied().unwrap_or(of_grid).get()
    }

    pub fn expire(&mut self, after: Duration) {
        self.now += after;
        let stalled = self.last_look.map_or(Duration::ZERO, |last| self.now.saturating_sub(last));
        let stalled = if stalled > STALL { stalled } else { Duration::ZERO };
        self.last_look = Some(self.now);
        let leases = self.farm.schedule.leases();
        let mut due: Vec<_> = leases.iter().filter(|h| h.deadline + stalled <= self.now).cloned().collect();
        due.sort_by_key(|held| (held.deadline, held.key.token));
        let freed = self.farm.look_over(self.now);
        self.insist(freed == due.len(), || format!("{freed} leases are freed, not {}", due.len()));
        for held in due.iter().filter(|h| h.running) {
            let (id, job) = (held.key.dictionary, held.key.job);
            let (origin, instance) = (self.origins[&held.worker], self.instances[&held.worker].clone());
            self.strike(id, job, origin, Some(instance));
        }
    }

    fn submit(&mut self, kind: usize) {
        if self.store.dictionaries.len() < DICTIONARIES {
            let id = self.store.create(kind);
            self.farm.add_dictionary(Dictionary::new(self.store.dictionaries[&id].clone(), &[]));
        }
    }

    fn set_desire(&mut self, at: usize, desire: DesiredState) {
        let Some(id) = self.dictionary(at) else { return };
        if self.farm.schedule.by_id(id).unwrap().open_jobs() > 0 {
            self.store.dictionaries.get_mut(&id).unwrap().desire = desire;
            self.farm.set_desire(id, desire, String::new());
        }
    }

    pub fn retry(&mut self, id: DictionaryId) {
        let of_it: Vec<_> = self.store.given_up.keys().filter(|job| job.0 == id).copied().collect();
        for place in &of_it {
            self.store.given_up.remove(place);
            self.walks.remove(place);
            self.strikes.remove(place);
        }
        let again = self.farm.retry(id);
        self.insist(again == of_it.len(), || format!("{again} jobs are tried again, not {}", of_it.len()));
        self.find_blocks();
    }

    fn delete(&mut self, at: usize) {
        let Some(id) = self.dictionary(at) else { return };
        self.set_desire(at, DesiredState::Cancel);
        self.store.delete(id);
        self.strikes.retain(|(of, _), _| *of != id);
        self.farm.remove_dictionary(id);
    }

    /// Restarts the coordinator on the same store.
    fn restart(&mut self) {
        self.farm = Dispatcher::new(self.settings);
        for known in self.store.machines() {
            self.farm.roster.remember_machine(known);
        }
        for (id, stored) in &self.store.dictionaries {
            self.farm.add_dictionary(Dictionary::new(stored.clone(), &self.store.ended(*id)));
        }
        for check in self.store.checks.values() {
            self.farm.remember_check(check.clone());
        }
        self.arriving.clear();
        self.judging = None;
        self.strikes.clear();
        self.draining.clear();
        self.last_look = None;
        self.walks = self.store.done.iter().map(|(place, done)| (*place, done.walks)).collect();
        self.find_blocks();
        for id in self.store.dictionaries.keys().copied().collect::<Vec<_>>() {
            self.take_over_done(id);
        }
    }

    /// Lets three honest workers finish the remaining work.
    pub fn finish_all(&mut self) -> Result<(), String> {
        while !self.arriving.is_empty() {
            self.end(0);
            self.settle();
        }
        for worker in 0..WORKERS {
            self.replace(worker, false);
        }
        for _ in 0..300 {
            // A dictionary that was done may be open again because a worker was fenced off, and still be paused.
            for at in 0..self.store.dictionaries.len() {
                self.set_desire(at, DesiredState::Run);
            }
            self.step(&Op::Expire(20));
            for id in self.store.dictionaries.keys().copied().collect::<Vec<_>>() {
                self.retry(id);
            }
            for worker in 0..3 {
                self.step(&Op::Renew(worker, 255, 255));
                self.step(&Op::Acquire(worker, 2));
                self.step(&Op::Deliver(worker, 0));
            }
            for _ in 0..6 {
                self.step(&Op::Judge);
            }
            self.check()?;
            // The model has the same dictionaries.
            let done = self.farm.schedule.dictionaries().all(|d| !d.is_active() || d.is_complete());
            if done && self.farm.verification.counts().2 == 0 && self.farm.schedule.load() == (0, 0) {
                return self.check_digests();
            }
        }
        let (load, counts) = (self.farm.schedule.load(), self.farm.verification.counts());
        Err(format!("the work is not done in time: {load:?} {counts:?}"))
    }
}
