//! The workers that are registered.

use std::collections::BTreeMap;
use std::time::Duration;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::status::{MachineFacts, WorkerState, WorkerStatus};

use super::machines::Machines;
use super::{DispatchError, Dispatcher, Effect, Event, EventKind};
use crate::stored::{KnownMachine, Machine, Origin};

/// Workers that hold no lease are forgotten after this long.
const FORGET: Duration = Duration::from_mins(10);

/// A process, by what it chose itself when it started.
pub(super) type Process = String;

/// What a worker tells of itself, and where it comes from.
#[derive(Debug, Clone)]
pub struct Registration {
    /// Tells the same process when it registers again.
    pub instance: Process,
    pub machine: Machine,
    pub label: String,
    pub threads: u32,
    pub version: String,
    pub facts: MachineFacts,
}

#[derive(Debug)]
pub(super) struct Worker {
    pub about: Registration,
    /// The machine.
    pub origin: Origin,
    pub last_seen: Duration,
    pub jobs_done: u64,
    pub draining: bool,
    /// It was asked to stop, and may be killed at any moment.
    pub stopping: bool,
}

impl Worker {
    /// Where to read on about what it failed at, to stand after a reason.
    pub fn log_note(&self) -> String {
        let log = &self.about.facts.log;
        if log.is_empty() { String::new() } else { format!(" (log: {log})") }
    }
}

#[derive(Debug, Default)]
pub(super) struct Workers {
    known: BTreeMap<WorkerId, Worker>,
    by_process: BTreeMap<(Origin, Process), WorkerId>,
    pub machines: Machines,
    /// Jobs that were blamed for the silence of a process, which may come back even when it was forgotten.
    blamed: BTreeMap<(Origin, Process), Vec<(DictionaryId, u32)>>,
}

/// Most workers of one token.
pub(super) const WORKERS_OF_ONE: usize = if cfg!(test) { 500 } else { 10_000 };

impl Workers {
    /// How many of a token are known.
    fn count_of(&self, token: &str) -> usize {
        self.known.values().filter(|worker| worker.about.machine.token == token).count()
    }

    pub fn get(&self, id: &WorkerId) -> Result<&Worker, DispatchError> {
        let worker = self.known.get(id).ok_or_else(|| DispatchError::UnknownWorker(id.clone()))?;
        match self.machines.reason(worker.origin) {
            Some(reason) => Err(DispatchError::Fenced(reason.to_owned())),
            None => Ok(worker),
        }
    }

    /// Notes a sign of life; jobs that were blamed for the silence of the process, and what it is.
    pub fn seen(
        &mut self,
        now: Duration,
        id: &WorkerId,
    ) -> Result<(Process, Vec<(DictionaryId, u32)>), DispatchError> {
        self.get(id)?;
        let worker = self.known.get_mut(id).ok_or_else(|| DispatchError::UnknownWorker(id.clone()))?;
        worker.last_seen = now;
        let process = (worker.origin, worker.about.instance.clone());
        let blamed = self.blamed.remove(&process).unwrap_or_default();
        Ok((process.1, blamed))
    }

    pub fn label_of(&self, origin: Origin) -> String {
        self.machines.label(origin).to_owned()
    }

    /// Notes that a job was blamed for a worker's silence.
    pub fn silent(&mut self, id: &WorkerId, job: (DictionaryId, u32)) {
        if let Some(worker) = self.known.get(id) {
            let process = (worker.origin, worker.about.instance.clone());
            self.blamed.entry(process).or_default().push(job);
        }
    }

    pub fn job_done(&mut self, id: &WorkerId) {
        if let Some(worker) = self.known.get_mut(id) {
            worker.jobs_done += 1;
        }
    }

    /// Workers of a machine.
    pub fn ids_of(&self, origin: Origin) -> Vec<WorkerId> {
        self.known.iter().filter(|(_, w)| w.origin == origin).map(|(id, _)| id.clone()).collect()
    }

    pub fn active(&self) -> impl Iterator<Item = (&WorkerId, &Worker)> {
        self.known.iter().filter(|(_, w)| !w.draining && !self.machines.is_fenced(w.origin))
    }

    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// Forgets those that were silent for long and may go; their labels.
    pub fn forget_silent(&mut self, now: Duration, may_go: impl Fn(&WorkerId) -> bool) -> Vec<String> {
        let gone: Vec<WorkerId> = self
            .known
            .iter()
            .filter(|(id, w)| now.saturating_sub(w.last_seen) >= FORGET && may_go(id))
            .map(|(id, _)| id.clone())
            .collect();
        gone.iter().filter_map(|id| self.remove(id)).map(|w| w.about.label).collect()
    }

    fn remove(&mut self, id: &WorkerId) -> Option<Worker> {
        let worker = self.known.remove(id)?;
        let process = (worker.origin, worker.about.instance.clone());
        if self.by_process.get(&process) == Some(id) {
            self.by_process.remove(&process);
        }
        Some(worker)
    }
}

impl Dispatcher {
    /// Lets a worker in; the same process registering again takes the place of its former self.
    pub fn register(
        &mut self,
        now: Duration,
        id: WorkerId,
        origin: Origin,
        about: Registration,
    ) -> Result<(), DispatchError> {
        let fence = self.workers.machines.fence_of(&about.machine);
        if let Some(reason) = fence.or_else(|| self.workers.machines.reason(origin)) {
            return Err(DispatchError::Fenced(reason.to_owned()));
        }
        let (mut jobs_done, mut draining) = (0, false);
        let process = (origin, about.instance.clone());
        if let Some(before) = self.workers.by_process.get(&process).cloned()
            && let Some(worker) = self.workers.remove(&before)
        {
            (jobs_done, draining) = (worker.jobs_done, worker.draining);
            // It did not get the answer to its first registration, or forgot: what it held waits again.
            for token in self.leases.of_worker(&before) {
                self.free(token);
            }
        } else if self.workers.count_of(&about.machine.token) >= WORKERS_OF_ONE {
            return Err(DispatchError::ManyWorkers { most: WORKERS_OF_ONE });
        } else {
            let s = if about.threads == 1 { "" } else { "s" };
            let message = format!("{} thread{s}, version {}", about.threads, about.version);
            self.outbox.events.push(Event::of_worker(EventKind::WorkerJoined, about.label.clone(), message));
        }
        self.workers.machines.met(origin, about.machine.clone(), &about.label);
        self.workers.by_process.insert(process, id.clone());
        self.workers
            .known
            .insert(id, Worker { about, origin, last_seen: now, jobs_done, draining, stopping: false });
        Ok(())
    }

    /// The token that authenticates a worker in its calls.
    pub fn worker_token(&self, id: &WorkerId) -> String {
        self.mac().worker_token(id)
    }

    /// The worker of a token.
    pub fn verify_worker(&self, token: &str) -> Result<WorkerId, DispatchError> {
        let known = |id: &str| DispatchError::UnknownWorker(WorkerId(id.chars().take(64).collect()));
        self.mac()
            .verify_worker(token)
            .ok_or_else(|| known(token.rsplit_once('.').map_or(token, |(id, _)| id)))
    }

    /// Takes up a machine that the store remembers.
    pub fn remember_machine(&mut self, known: KnownMachine) {
        self.workers.machines.remember(known);
    }

    /// Whether each token has one vote, or each machine: tokens, if there are several for workers.
    pub fn set_votes_by_token(&mut self, by_token: bool) {
        self.workers.machines.set_votes_by_token(by_token);
    }

    /// The machine of a worker.
    pub fn origin_of(&self, id: &WorkerId) -> Result<Origin, DispatchError> {
        self.workers.get(id).map(|w| w.origin)
    }

    /// Lets a machine in again that was fenced off, found by what its worker was called, or by token and address. What was
    /// set aside comes back as far as it was not computed again.
    pub fn lift_fence(&mut self, which: &str) -> Result<Origin, String> {
        let named = |known: &&KnownMachine| known.label == which || known.machine.identity() == which;
        let found: Vec<Origin> =
            self.workers.machines.fenced().filter(named).map(|known| known.origin).collect();
        match found[..] {
            [origin] => {
                self.workers.machines.lift(origin);
                let label = self.workers.label_of(origin);
                let message = "an admin lets it in again";
                self.outbox.events.push(Event::of_worker(EventKind::WorkerReadmitted, label, message));
                self.outbox.effects.push(Effect::LiftFence { machine: origin });
                self.work_came();
                Ok(origin)
            }
            _ => Err(self.fenced_by_name(found.len())),
        }
    }

    fn fenced_by_name(&self, found: usize) -> String {
        let name = |known: &KnownMachine| format!("{} ({})", known.machine.identity(), known.label);
        let fenced: Vec<String> = self.workers.machines.fenced().map(name).collect();
        match (found, fenced.is_empty()) {
            (_, true) => "no machine is fenced off".to_owned(),
            (0, _) => format!("no machine of this name is fenced off: there are {}", fenced.join(", ")),
            _ => format!(
                "several machines have this label: name one as TOKEN@ADDRESS of {}",
                fenced.join(", ")
            ),
        }
    }

    /// Notes that a worker was asked to stop: nobody is to blame if it falls silent.
    pub fn stopping(&mut self, id: &WorkerId) {
        if let Some(worker) = self.workers.known.get_mut(id) {
            worker.stopping = true;
        }
    }

    /// Forgets a worker and frees all its leases, without blame.
    pub fn leave(&mut self, id: &WorkerId) {
        for token in self.leases.of_worker(id) {
            self.free(token);
        }
        if let Some(worker) = self.workers.known.get(id) {
            let now = worker.last_seen;
            // It was heard of once more. One that is fenced off brings nothing.
            let _ = self.seen(now, id);
        }
        if let Some(worker) = self.workers.remove(id) {
            let message = format!("{} jobs done", worker.jobs_done);
            self.outbox.changed = true;
            self.outbox.events.push(Event::of_worker(EventKind::WorkerLeft, worker.about.label, message));
        }
    }

    /// Lets a worker finish what it has and leave. Found by id, or by label if only one has it.
    pub fn drain(&mut self, which: &str) -> Result<WorkerId, String> {
        let found: Vec<WorkerId> = self
            .workers
            .known
            .iter()
            .filter(|(id, w)| id.0 == which || w.about.label == which)
            .map(|(id, _)| id.clone())
            .collect();
        match &found[..] {
            [id] => {
                let worker = self.workers.known.get_mut(id).expect("it was just found");
                worker.draining = true;
                let label = worker.about.label.clone();
                // If it waits for work it is to hear of it at once.
                self.outbox.work = true;
                self.outbox.events.push(Event::of_worker(EventKind::WorkerDraining, label, "asked to leave"));
                Ok(id.clone())
            }
            [] => Err("no worker has this id or label".to_owned()),
            several => Err(format!("{} workers have this label: name one by its id", several.len())),
        }
    }

    /// Number of workers and of their threads.
    pub fn strength(&self) -> (usize, u64) {
        (self.workers.len(), self.workers.known.values().map(|w| u64::from(w.about.threads)).sum())
    }

    /// Workers in the order of their ids, from the one after `after` on.
    pub fn workers(&self, now: Duration, after: &WorkerId, most: usize) -> Vec<WorkerStatus> {
        let range = (std::ops::Bound::Excluded(after.clone()), std::ops::Bound::Unbounded);
        self.workers.known.range(range).take(most).map(|(id, w)| self.worker_status(now, id, w)).collect()
    }

    /// Whether a worker has missed so many heartbeats that its leases have expired.
    pub(super) fn is_silent(&self, now: Duration, worker: &Worker) -> bool {
        now.saturating_sub(worker.last_seen) > self.settings.lease
    }

    fn worker_status(&self, now: Duration, id: &WorkerId, worker: &Worker) -> WorkerStatus {
        let leases = self.leases.count_of(id);
        let suspended = self.workers.machines.pause_left(now, worker.origin);
        let state = match leases {
            _ if self.workers.machines.is_fenced(worker.origin) => WorkerState::Fenced,
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
