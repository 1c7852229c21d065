//! Which job goes to which worker: a state machine over plain data.
//!
//! Synchronous, and blind to clocks, randomness, network and store: time comes in as a monotonic [`Duration`],
//! tokens as strings, results as calls. Whoever calls makes the effects durable first.

mod dictionary;
mod plan;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::time::Duration;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::job::{JobSpec, Lease, LeaseKey};
use farm_proto::status::{DictionaryStatus, WorkerStatus};
use farm_proto::{DictionaryName, Digest};

pub use dictionary::Dictionary;
use dictionary::Held;

/// Workers that hold no lease are forgotten after this long.
const FORGET_WORKER: Duration = Duration::from_mins(10);

#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// How long a lease holds without a word from its worker.
    pub lease: Duration,
    /// Failed attempts after which a job is given up.
    pub max_attempts: u32,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DispatchError {
    #[error("worker {0} is not registered here: register again")]
    UnknownWorker(WorkerId),
    #[error("lease of job {job} (attempt {attempt}) is no longer held: drop the result")]
    LeaseLost { job: u32, attempt: u32 },
    #[error("dictionary number {0} does not exist")]
    UnknownDictionary(i64),
}

#[derive(Debug)]
struct Worker {
    label: String,
    threads: u32,
    last_seen: Duration,
    jobs_done: u64,
}

/// All dictionaries and workers of the farm.
#[derive(Debug)]
pub struct Farm {
    settings: Settings,
    dictionaries: BTreeMap<DictionaryId, Dictionary>,
    workers: BTreeMap<WorkerId, Worker>,
}

impl Farm {
    pub fn new(settings: Settings) -> Self {
        Self { settings, dictionaries: BTreeMap::new(), workers: BTreeMap::new() }
    }

    pub fn settings(&self) -> Settings {
        self.settings
    }

    pub fn add_dictionary(&mut self, dictionary: Dictionary) {
        self.dictionaries.entry(dictionary.id()).or_insert(dictionary);
    }

    pub fn dictionaries(&self) -> impl Iterator<Item = &Dictionary> {
        self.dictionaries.values()
    }

    pub fn by_name(&self, name: &DictionaryName) -> Option<&Dictionary> {
        self.dictionaries.values().find(|d| d.name() == name)
    }

    pub fn status(&self, name: &DictionaryName) -> Option<DictionaryStatus> {
        self.by_name(name).map(Dictionary::status)
    }

    pub fn register(&mut self, now: Duration, id: WorkerId, label: String, threads: u32) {
        self.workers.insert(id, Worker { label, threads, last_seen: now, jobs_done: 0 });
    }

    /// Gives out up to `max` jobs, the costliest of the oldest dictionary first.
    pub fn acquire(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        max: usize,
        mut token: impl FnMut() -> String,
    ) -> Result<Vec<Lease>, DispatchError> {
        self.seen(now, worker)?;
        let deadline = now + self.settings.lease;
        let mut leases = Vec::new();
        for dictionary in self.dictionaries.values_mut() {
            while leases.len() < max {
                let held = Held { worker: worker.clone(), token: token(), deadline };
                let Some((job, attempt, token)) = dictionary.lease_next(held) else { break };
                let key = LeaseKey { dictionary: dictionary.id(), job, attempt, token };
                leases.push(Lease { key, job: JobSpec::of(dictionary.grid(), job as usize) });
            }
        }
        Ok(leases)
    }

    /// Extends leases; returns those that are lost.
    pub fn renew(
        &mut self,
        now: Duration,
        worker: &WorkerId,
        leases: Vec<LeaseKey>,
    ) -> Result<Vec<LeaseKey>, DispatchError> {
        self.seen(now, worker)?;
        let deadline = now + self.settings.lease;
        Ok(leases.into_iter().filter(|key| !self.extend(key, deadline)).collect())
    }

    fn extend(&mut self, key: &LeaseKey, deadline: Duration) -> bool {
        self.dictionaries.get_mut(&key.dictionary).is_some_and(|d| d.extend(key, deadline))
    }

    /// Whether results under this lease are wanted: it is held, or its job is done, so that the result can be
    /// compared with what is stored.
    pub fn check_completion(&self, key: &LeaseKey) -> Result<&Dictionary, DispatchError> {
        let dictionary = self.dictionary(key)?;
        if dictionary.holds(key) || dictionary.is_done(key.job) {
            return Ok(dictionary);
        }
        Err(DispatchError::LeaseLost { job: key.job, attempt: key.attempt })
    }

    /// Notes that a job's records are stored.
    pub fn completed(&mut self, now: Duration, key: &LeaseKey, records: Digest) {
        let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) else { return };
        if let Some(worker) = dictionary.finish(key.job, records).and_then(|id| self.workers.get_mut(&id)) {
            worker.jobs_done += 1;
            worker.last_seen = now;
        }
    }

    /// Takes leases back without blame; those that are not held are passed over.
    pub fn hand_back(&mut self, leases: &[LeaseKey]) {
        for key in leases {
            if let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) {
                dictionary.hand_back(key);
            }
        }
    }

    /// All reasons, with this one, if one more failed attempt means that the job is given up.
    pub fn reasons_to_give_up(&self, key: &LeaseKey, reason: &str) -> Result<Option<String>, DispatchError> {
        let dictionary = self.dictionary(key)?;
        let reasons = dictionary.reasons_with(key, reason);
        let reasons = reasons.ok_or(DispatchError::LeaseLost { job: key.job, attempt: key.attempt })?;
        Ok((reasons.len() >= self.settings.max_attempts as usize).then(|| reasons.join("; ")))
    }

    /// Counts a failed attempt; the job is tried again or given up.
    pub fn failed(&mut self, key: &LeaseKey, reason: &str) -> Result<(), DispatchError> {
        let give_up = self.reasons_to_give_up(key, reason)?;
        if let Some(dictionary) = self.dictionaries.get_mut(&key.dictionary) {
            dictionary.fail(key, reason, give_up);
        }
        Ok(())
    }

    /// Forgets a worker and frees all its leases, without blame.
    pub fn leave(&mut self, worker: &WorkerId) {
        self.workers.remove(worker);
        for dictionary in self.dictionaries.values_mut() {
            dictionary.free_leases_of(worker);
        }
    }

    /// Frees leases past their deadline and forgets workers long silent; returns the number of leases freed.
    pub fn expire(&mut self, now: Duration) -> usize {
        let freed = self.dictionaries.values_mut().map(|d| d.expire(now)).sum();
        let dictionaries = &self.dictionaries;
        self.workers.retain(|id, w| {
            now.saturating_sub(w.last_seen) < FORGET_WORKER
                || dictionaries.values().any(|d| d.leases_of(id) > 0)
        });
        freed
    }

    pub fn workers(&self, now: Duration) -> Vec<WorkerStatus> {
        let status = |(id, w): (&WorkerId, &Worker)| WorkerStatus {
            id: id.clone(),
            label: w.label.clone(),
            threads: w.threads,
            leases: self.dictionaries.values().map(|d| d.leases_of(id)).sum::<usize>() as u32,
            jobs_done: w.jobs_done,
            silent_ms: now.saturating_sub(w.last_seen).as_millis() as u64,
        };
        self.workers.iter().map(status).collect()
    }

    fn dictionary(&self, key: &LeaseKey) -> Result<&Dictionary, DispatchError> {
        let found = self.dictionaries.get(&key.dictionary).filter(|d| d.has_job(key.job));
        found.ok_or(DispatchError::UnknownDictionary(key.dictionary.0))
    }

    fn seen(&mut self, now: Duration, id: &WorkerId) -> Result<(), DispatchError> {
        let worker = self.workers.get_mut(id).ok_or_else(|| DispatchError::UnknownWorker(id.clone()))?;
        worker.last_seen = now;
        Ok(())
    }
}
