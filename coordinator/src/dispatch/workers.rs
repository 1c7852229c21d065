//! The workers that are registered.

use std::collections::BTreeMap;
use std::time::Duration;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::status::{WorkerState, WorkerStatus};

use super::{DispatchError, Dispatcher, Event, EventKind};
use crate::stored::Origin;

/// Workers that hold no lease are forgotten after this long.
const FORGET: Duration = Duration::from_mins(10);

/// What a worker tells of itself.
#[derive(Debug, Clone)]
pub struct Registration {
    pub label: String,
    pub threads: u32,
    pub version: String,
}

#[derive(Debug)]
pub(super) struct Worker {
    pub about: Registration,
    /// The process, which stays the same when it registers again.
    pub origin: Origin,
    pub last_seen: Duration,
    pub jobs_done: u64,
    pub draining: bool,
}

#[derive(Debug, Default)]
pub(super) struct Workers {
    known: BTreeMap<WorkerId, Worker>,
    by_origin: BTreeMap<Origin, WorkerId>,
    /// Processes that computed wrongly, with the reasons.
    fenced: BTreeMap<Origin, String>,
    /// Jobs that were blamed for the silence of a process, which may come back even when it was forgotten.
    blamed: BTreeMap<Origin, Vec<(DictionaryId, u32)>>,
}

impl Workers {
    pub fn get(&self, id: &WorkerId) -> Result<&Worker, DispatchError> {
        let worker = self.known.get(id).ok_or_else(|| DispatchError::UnknownWorker(id.clone()))?;
        match self.fenced.get(&worker.origin) {
            Some(reason) => Err(DispatchError::Fenced(reason.clone())),
            None => Ok(worker),
        }
    }

    /// Notes a sign of life.
    pub fn seen(&mut self, now: Duration, id: &WorkerId) -> Result<Origin, DispatchError> {
        self.get(id)?;
        let worker = self.known.get_mut(id).ok_or_else(|| DispatchError::UnknownWorker(id.clone()))?;
        worker.last_seen = now;
        Ok(worker.origin)
    }

    /// Jobs that were blamed for the silence of a process that is silent no more.
    pub fn returned(&mut self, origin: Origin) -> Vec<(DictionaryId, u32)> {
        self.blamed.remove(&origin).unwrap_or_default()
    }

    pub fn label_of(&self, origin: Origin) -> String {
        let worker = self.by_origin.get(&origin).and_then(|id| self.known.get(id));
        worker.map(|w| w.about.label.clone()).unwrap_or_default()
    }

    pub fn silent(&mut self, origin: Origin, job: (DictionaryId, u32)) {
        self.blamed.entry(origin).or_default().push(job);
    }

    pub fn job_done(&mut self, id: &WorkerId) {
        if let Some(worker) = self.known.get_mut(id) {
            worker.jobs_done += 1;
        }
    }

    pub fn fence(&mut self, origin: Origin, reason: String) {
        self.fenced.insert(origin, reason);
    }

    pub fn is_fenced(&self, origin: Origin) -> bool {
        self.fenced.contains_key(&origin)
    }

    pub fn ids_of(&self, origin: Origin) -> Vec<WorkerId> {
        self.by_origin.get(&origin).cloned().into_iter().collect()
    }

    pub fn active(&self) -> impl Iterator<Item = (&WorkerId, &Worker)> {
        self.known.iter().filter(|(_, w)| !w.draining && !self.fenced.contains_key(&w.origin))
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
        if self.by_origin.get(&worker.origin) == Some(id) {
            self.by_origin.remove(&worker.origin);
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
        if let Some(reason) = self.workers.fenced.get(&origin) {
            return Err(DispatchError::Fenced(reason.clone()));
        }
        let (mut jobs_done, mut draining) = (0, false);
        if let Some(before) = self.workers.by_origin.get(&origin).cloned()
            && let Some(worker) = self.workers.remove(&before)
        {
            (jobs_done, draining) = (worker.jobs_done, worker.draining);
            // It did not get the answer to its first registration, or forgot: what it held waits again.
            for token in self.leases.of_worker(&before) {
                self.free(token);
            }
        } else {
            let message = format!("{} threads, version {}", about.threads, about.version);
            self.outbox.events.push(Event::of_worker(EventKind::WorkerJoined, about.label.clone(), message));
        }
        self.workers.by_origin.insert(origin, id.clone());
        self.workers.known.insert(id, Worker { about, origin, last_seen: now, jobs_done, draining });
        Ok(())
    }

    /// Takes up a fence that the store remembers.
    pub fn remember_fence(&mut self, origin: Origin, reason: String) {
        self.workers.fence(origin, reason);
    }

    /// The process behind a worker's id.
    pub fn origin_of(&self, id: &WorkerId) -> Result<Origin, DispatchError> {
        self.workers.get(id).map(|w| w.origin)
    }

    /// Forgets a worker and frees all its leases, without blame.
    pub fn leave(&mut self, id: &WorkerId) {
        for token in self.leases.of_worker(id) {
            self.free(token);
        }
        if let Some(worker) = self.workers.remove(id) {
            self.forgive(worker.origin);
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
        let state = match leases {
            _ if self.workers.is_fenced(worker.origin) => WorkerState::Fenced,
            _ if self.is_silent(now, worker) => WorkerState::Silent,
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
            version: worker.about.version.clone(),
        }
    }
}
