//! Keeps the registered workers and their machines, and records which of them are silent, draining, suspended or fenced off.

mod machines;
mod worker_token;

use std::collections::BTreeMap;
use std::time::Duration;

use farm_proto::ids::WorkerId;
use farm_proto::status::{MachineFacts, WorkerState, WorkerStatus};

use super::outbox::{Event, EventKind, Outbox};
use super::part::JobRef;
use super::{DispatchError, Settings};
use crate::stored::{KnownMachine, Machine, Origin};
use machines::Machines;

/// Time of silence after which a worker without leases is removed.
const FORGET: Duration = Duration::from_mins(10);

/// A process, identified by the random name that it generated at its start.
pub type Process = String;

/// A worker's description of itself, with the machine from which it connects.
#[derive(Debug, Clone)]
pub struct Registration {
    /// Unchanged when a process registers again.
    pub instance: Process,
    pub machine: Machine,
    pub label: String,
    pub threads: u32,
    pub version: String,
    pub facts: MachineFacts,
}

#[derive(Debug)]
pub struct Worker {
    pub about: Registration,
    /// The machine.
    pub origin: Origin,
    pub last_seen: Duration,
    /// Results delivered: of whole jobs, and of the blocks of divided ones.
    pub jobs_done: u64,
    pub draining: bool,
    /// It was asked to stop, and may be killed at any moment.
    pub stopping: bool,
}

impl Worker {
    /// The place of its log, to be appended to the reason of a failure.
    pub fn log_note(&self) -> String {
        let log = &self.about.facts.log;
        if log.is_empty() { String::new() } else { format!(" (log: {log})") }
    }

    fn process(&self) -> (Origin, Process) {
        (self.origin, self.about.instance.clone())
    }
}

/// All workers, and all machines that have ever connected.
#[derive(Debug)]
pub struct Roster {
    settings: Settings,
    known: BTreeMap<WorkerId, Worker>,
    by_process: BTreeMap<(Origin, Process), WorkerId>,
    machines: Machines,
    /// Jobs that were blamed for the silence of a process, which may come back even after its removal.
    blamed: BTreeMap<(Origin, Process), Vec<JobRef>>,
}

/// Most workers of one token.
pub const WORKERS_OF_ONE: usize = if cfg!(test) { 500 } else { 10_000 };

impl Roster {
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            known: BTreeMap::new(),
            by_process: BTreeMap::new(),
            machines: Machines::default(),
            blamed: BTreeMap::new(),
        }
    }

    /// A registered worker whose machine is not fenced off.
    pub fn get(&self, id: &WorkerId) -> Result<&Worker, DispatchError> {
        let worker = self.known.get(id).ok_or_else(|| DispatchError::UnknownWorker(id.clone()))?;
        match self.machines.reason(worker.origin) {
            Some(reason) => Err(DispatchError::Fenced(reason.to_owned())),
            None => Ok(worker),
        }
    }

    /// Notes a call of a worker. Returns its process, and the jobs that were blamed for its silence.
    pub fn seen(&mut self, now: Duration, id: &WorkerId) -> Result<(Process, Vec<JobRef>), DispatchError> {
        self.get(id)?;
        let worker = self.known.get_mut(id).ok_or_else(|| DispatchError::UnknownWorker(id.clone()))?;
        worker.last_seen = now;
        let process = worker.process();
        let blamed = self.blamed.remove(&process).unwrap_or_default();
        Ok((process.1, blamed))
    }

    /// Registers a worker. A process that registers again replaces its former registration, whose id is returned.
    pub fn register(
        &mut self,
        now: Duration,
        id: WorkerId,
        origin: Origin,
        about: Registration,
        outbox: &mut Outbox,
    ) -> Result<Option<WorkerId>, DispatchError> {
        let fence = self.machines.fence_of(&about.machine).or_else(|| self.machines.reason(origin));
        if let Some(reason) = fence {
            return Err(DispatchError::Fenced(reason.to_owned()));
        }
        let (mut jobs_done, mut draining) = (0, false);
        let process = (origin, about.instance.clone());
        let before = self.by_process.get(&process).cloned();
        let replaced = before.filter(|before| self.known.contains_key(before));
        if let Some(worker) = replaced.as_ref().and_then(|before| self.remove(before)) {
            (jobs_done, draining) = (worker.jobs_done, worker.draining);
        } else if self.count_of(&about.machine.token) >= WORKERS_OF_ONE {
            return Err(DispatchError::ManyWorkers { most: WORKERS_OF_ONE });
        } else {
            let s = if about.threads == 1 { "" } else { "s" };
            let message = format!("{} thread{s}, version {}", about.threads, about.version);
            outbox.events.push(Event::of_worker(EventKind::WorkerJoined, about.label.clone(), message));
        }
        self.machines.met(origin, about.machine.clone(), &about.label);
        self.by_process.insert(process, id.clone());
        let worker = Worker { about, origin, last_seen: now, jobs_done, draining, stopping: false };
        self.known.insert(id, worker);
        Ok(replaced)
    }

    /// Number of registered workers with an access token.
    fn count_of(&self, token: &str) -> usize {
        self.known.values().filter(|worker| worker.about.machine.token == token).count()
    }

    /// Removes a worker that leaves. Returns its process and the jobs that were blamed for its silence, since it has made
    /// contact once more.
    pub fn leave(&mut self, id: &WorkerId, outbox: &mut Outbox) -> Option<(Process, Vec<JobRef>)> {
        let last_seen = self.known.get(id)?.last_seen;
        // A worker that is fenced off withdraws no blame.
        let heard = self.seen(last_seen, id).ok();
        let worker = self.remove(id)?;
        let message = format!("{} results delivered", worker.jobs_done);
        outbox.changed = true;
        outbox.events.push(Event::of_worker(EventKind::WorkerLeft, worker.about.label, message));
        heard
    }

    /// Removes workers that have been silent for too long, as far as `may_go` permits.
    pub fn forget_silent(&mut self, now: Duration, may_go: impl Fn(&WorkerId) -> bool, outbox: &mut Outbox) {
        let is_gone = |w: &Worker| now.saturating_sub(w.last_seen) >= FORGET;
        let gone = self.known.iter().filter(|(id, w)| is_gone(w) && may_go(id)).map(|(id, _)| id.clone());
        for worker in gone.collect::<Vec<_>>().iter().filter_map(|id| self.remove(id)) {
            let label = worker.about.label;
            outbox.events.push(Event::of_worker(EventKind::WorkerGone, label, "not heard of any more"));
            outbox.changed = true;
        }
    }

    fn remove(&mut self, id: &WorkerId) -> Option<Worker> {
        let worker = self.known.remove(id)?;
        let process = worker.process();
        if self.by_process.get(&process) == Some(id) {
            self.by_process.remove(&process);
        }
        Some(worker)
    }

    /// Marks a worker, found by its id or its unique label, to finish its parts and leave.
    pub fn drain(&mut self, which: &str, outbox: &mut Outbox) -> Result<WorkerId, String> {
        let is_meant = |(id, w): &(&WorkerId, &mut Worker)| id.0 == which || w.about.label == which;
        let mut found: Vec<(&WorkerId, &mut Worker)> = self.known.iter_mut().filter(is_meant).collect();
        match &mut found[..] {
            [(id, worker)] => {
                worker.draining = true;
                let label = worker.about.label.clone();
                // If the worker waits for work, it must be woken at once.
                outbox.work = true;
                outbox.events.push(Event::of_worker(EventKind::WorkerDraining, label, "asked to leave"));
                Ok(id.clone())
            }
            [] => Err("no worker has this id or label".to_owned()),
            several => Err(format!("{} workers have this label: name one by its id", several.len())),
        }
    }

    /// Notes that a worker was asked to stop, so that it is not blamed when it falls silent.
    pub fn stopping(&mut self, id: &WorkerId) {
        if let Some(worker) = self.known.get_mut(id) {
            worker.stopping = true;
        }
    }

    /// Notes that a job was blamed for a worker's silence.
    pub fn blamed(&mut self, id: &WorkerId, job: JobRef) {
        if let Some(worker) = self.known.get(id) {
            self.blamed.entry(worker.process()).or_default().push(job);
        }
    }

    /// Notes that a worker of a machine has delivered a result.
    pub fn delivered(&mut self, id: &WorkerId, machine: Origin) {
        if let Some(worker) = self.known.get_mut(id) {
            worker.jobs_done += 1;
        }
        self.machines.succeeded(machine);
    }

    /// Counts a failed job against a machine.
    pub fn failed(&mut self, now: Duration, machine: Origin, job: JobRef, reason: &str, outbox: &mut Outbox) {
        let alone = !self.able(now).any(|other| other != machine);
        if let Some(pause) = self.machines.failed(now, machine, job, alone) {
            let message =
                format!("it fails one job after the other and gets none for {} s; {reason}", pause.as_secs());
            let label = self.label_of(machine);
            outbox.events.push(Event::of_worker(EventKind::WorkerSuspended, label, message));
            outbox.changed = true;
        }
    }

    /// Removes a job from the failures of all machines, since several of them have failed at it. True if that ends a pause.
    pub fn exonerate(&mut self, now: Duration, job: JobRef) -> bool {
        self.machines.exonerate(now, job)
    }

    /// Fences a machine off; false if it is fenced off already.
    pub fn fence(&mut self, machine: Origin, reason: &str, outbox: &mut Outbox) -> bool {
        if self.machines.is_fenced(machine) {
            return false;
        }
        self.machines.fence(machine, reason.to_owned());
        let label = self.label_of(machine);
        outbox.events.push(Event::of_worker(EventKind::WorkerFenced, label, reason));
        true
    }

    /// Adds a machine from the store.
    pub fn remember_machine(&mut self, known: KnownMachine) {
        self.machines.remember(known);
    }

    pub fn is_fenced(&self, machine: Origin) -> bool {
        self.machines.is_fenced(machine)
    }

    pub fn label_of(&self, machine: Origin) -> String {
        self.machines.label(machine).to_owned()
    }

    /// Name of the access token that a machine has presented.
    pub fn access_token(&self, machine: Origin) -> &str {
        self.machines.access_token(machine)
    }

    /// The token that authenticates a worker in its calls.
    pub fn worker_token(&self, id: &WorkerId) -> String {
        worker_token::issue(&self.settings.secret, id)
    }

    /// The worker of a token.
    pub fn verify_worker(&self, token: &str) -> Result<WorkerId, DispatchError> {
        let unknown = |id: &str| DispatchError::UnknownWorker(WorkerId(id.chars().take(64).collect()));
        worker_token::verify(&self.settings.secret, token)
            .ok_or_else(|| unknown(token.rsplit_once('.').map_or(token, |(id, _)| id)))
    }

    /// Workers of a machine.
    pub fn ids_of(&self, machine: Origin) -> impl Iterator<Item = &WorkerId> {
        self.known.iter().filter(move |(_, w)| w.origin == machine).map(|(id, _)| id)
    }

    pub fn active(&self) -> impl Iterator<Item = (&WorkerId, &Worker)> {
        self.known.iter().filter(|(_, w)| !w.draining && !self.machines.is_fenced(w.origin))
    }

    /// Machines that could take a job now or soon.
    pub fn able(&self, now: Duration) -> impl Iterator<Item = Origin> {
        let here = self.active().filter(move |(_, worker)| !self.is_silent(now, worker));
        let origins = here.map(|(_, worker)| worker.origin);
        origins.filter(move |origin| self.pause_left(now, *origin).is_none())
    }

    /// Whether a worker has been silent for so long that its leases have expired.
    pub fn is_silent(&self, now: Duration, worker: &Worker) -> bool {
        now.saturating_sub(worker.last_seen) > self.settings.lease
    }

    /// Time until the pause of a machine ends; None if it has none.
    pub fn pause_left(&self, now: Duration, machine: Origin) -> Option<Duration> {
        self.machines.pause_left(now, machine)
    }

    /// Whether a pause has ended between two times.
    pub fn pause_ended(&self, after: Duration, now: Duration) -> bool {
        self.machines.pause_ended(after, now)
    }

    /// Whether a machine gets only one job at a time, since it had a pause.
    pub fn is_on_trial(&self, machine: Origin) -> bool {
        self.machines.is_on_trial(machine)
    }

    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// Number of workers and of their threads.
    pub fn strength(&self) -> (usize, u64) {
        (self.len(), self.known.values().map(|w| u64::from(w.about.threads)).sum())
    }

    /// Workers in the order of their ids, from the one after `after` on. `leases`: how many leases a worker holds.
    pub fn statuses(
        &self,
        now: Duration,
        after: &WorkerId,
        most: usize,
        leases: impl Fn(&WorkerId) -> usize,
    ) -> Vec<WorkerStatus> {
        let range = (std::ops::Bound::Excluded(after.clone()), std::ops::Bound::Unbounded);
        self.known.range(range).take(most).map(|(id, w)| self.status(now, id, w, leases(id))).collect()
    }

    fn status(&self, now: Duration, id: &WorkerId, worker: &Worker, leases: usize) -> WorkerStatus {
        let suspended = self.pause_left(now, worker.origin);
        let state = match leases {
            _ if self.machines.is_fenced(worker.origin) => WorkerState::Fenced,
            _ if self.is_silent(now, worker) => WorkerState::Silent,
            _ if suspended.is_some() => WorkerState::Suspended,
            _ if worker.draining => WorkerState::Draining,
            0 => WorkerState::Idle,
            _ => WorkerState::Working,
        };
        WorkerStatus {
            id: id.clone(),
            label: worker.about.label.clone(),
            threads: worker.about.threads,
            leases: leases as u32,
            jobs_done: worker.jobs_done,
            silent_ms: now.saturating_sub(worker.last_seen).as_millis() as u64,
            state,
            suspended_ms: suspended.map_or(0, |left| left.as_millis() as u64),
            version: worker.about.version.clone(),
            facts: worker.about.facts.clone(),
            machine: worker.about.machine.identity(),
        }
    }
}
