//! The jobs of one dictionary and their states.

use std::collections::BTreeSet;
use std::time::Duration;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::job::LeaseKey;
use farm_proto::status::{DictionaryState, DictionaryStatus, FailedJob};
use farm_proto::{DictionaryName, Digest, Grid};

use super::plan;
use crate::store::{EndedJob, StoredDictionary};

#[derive(Debug)]
enum State {
    Pending,
    Leased(Held),
    Done(Digest),
    Failed(String),
}

/// Who holds a lease, and until when.
#[derive(Debug)]
pub(super) struct Held {
    pub worker: WorkerId,
    pub token: String,
    pub deadline: Duration,
}

#[derive(Debug)]
struct Job {
    state: State,
    /// Leases given out so far.
    attempts: u32,
    /// Why attempts failed.
    reasons: Vec<String>,
    /// Place in the order of work.
    rank: u32,
    cost: f64,
}

/// A dictionary and the state of each of its jobs.
#[derive(Debug)]
pub struct Dictionary {
    stored: StoredDictionary,
    jobs: Vec<Job>,
    /// Pending jobs as (rank, job).
    pending: BTreeSet<(u32, u32)>,
    leased: BTreeSet<u32>,
    total_cost: f64,
}

impl Dictionary {
    /// Takes up a dictionary as the store has it: what has not ended is pending.
    pub fn new(stored: StoredDictionary, ended: Vec<EndedJob>) -> Self {
        let new_job = |job: usize| Job {
            state: State::Pending,
            attempts: 0,
            reasons: Vec::new(),
            rank: 0,
            cost: plan::cost(&stored.grid.point(job)),
        };
        let mut jobs: Vec<Job> = (0..stored.grid.job_count()).map(new_job).collect();
        for (rank, job) in plan::longest_first(&stored.grid).into_iter().enumerate() {
            jobs[job as usize].rank = rank as u32;
        }
        for end in ended {
            let (job, state) = match end {
                EndedJob::Done { job, records } => (job, State::Done(records)),
                EndedJob::Failed { job, reason } => (job, State::Failed(reason)),
            };
            if let Some(job) = jobs.get_mut(job as usize) {
                job.state = state;
            }
        }
        let pending = jobs.iter().zip(0..).filter(|(j, _)| matches!(j.state, State::Pending));
        let pending = pending.map(|(j, i)| (j.rank, i)).collect();
        let total_cost = jobs.iter().map(|j| j.cost).sum();
        Self { stored, jobs, pending, leased: BTreeSet::new(), total_cost }
    }

    pub fn id(&self) -> DictionaryId {
        self.stored.id
    }

    pub fn name(&self) -> &DictionaryName {
        &self.stored.name
    }

    pub fn grid(&self) -> &Grid {
        &self.stored.grid
    }

    pub fn grid_digest(&self) -> Digest {
        self.stored.grid_digest
    }

    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    pub fn leased(&self) -> usize {
        self.leased.len()
    }

    pub fn state(&self) -> DictionaryState {
        self.status().state()
    }

    /// Whether every record is there.
    pub fn is_complete(&self) -> bool {
        self.pending.is_empty()
            && self.leased.is_empty()
            && self.jobs.iter().all(|j| matches!(j.state, State::Done(_)))
    }

    pub fn status(&self) -> DictionaryStatus {
        let done = || self.jobs.iter().filter(|j| matches!(j.state, State::Done(_)));
        let failed = self.jobs.iter().zip(0..).filter_map(|(j, job)| match &j.state {
            State::Failed(reason) => Some(FailedJob { job, reason: reason.clone() }),
            _ => None,
        });
        let digests: Option<Vec<Digest>> = self
            .jobs
            .iter()
            .map(|j| if let State::Done(digest) = j.state { Some(digest) } else { None })
            .collect();
        DictionaryStatus {
            name: self.stored.name.clone(),
            grid: self.stored.grid.clone(),
            grid_digest: self.stored.grid_digest,
            records_digest: digests.map(Digest::of_jobs),
            created_unix_ms: self.stored.created_unix_ms,
            jobs_done: done().count(),
            jobs_leased: self.leased.len(),
            failed: failed.collect(),
            work_done: done().map(|j| j.cost).sum::<f64>() / self.total_cost,
        }
    }

    pub(super) fn has_job(&self, job: u32) -> bool {
        (job as usize) < self.jobs.len()
    }

    pub(super) fn is_done(&self, job: u32) -> bool {
        matches!(self.jobs[job as usize].state, State::Done(_))
    }

    pub(super) fn holds(&self, key: &LeaseKey) -> bool {
        self.jobs.get(key.job as usize).is_some_and(|job| match &job.state {
            State::Leased(held) => held.token == key.token && job.attempts == key.attempt,
            _ => false,
        })
    }

    pub(super) fn leases_of(&self, worker: &WorkerId) -> usize {
        self.leased.iter().filter(|job| self.is_held_by(**job, worker)).count()
    }

    fn is_held_by(&self, job: u32, worker: &WorkerId) -> bool {
        matches!(&self.jobs[job as usize].state, State::Leased(held) if held.worker == *worker)
    }

    /// Leases the next pending job: its number, attempt and token.
    pub(super) fn lease_next(&mut self, held: Held) -> Option<(u32, u32, String)> {
        let (_, index) = self.pending.pop_first()?;
        let job = &mut self.jobs[index as usize];
        job.attempts += 1;
        let token = held.token.clone();
        job.state = State::Leased(held);
        self.leased.insert(index);
        Some((index, job.attempts, token))
    }

    pub(super) fn extend(&mut self, key: &LeaseKey, until: Duration) -> bool {
        let holds = self.holds(key);
        if holds && let State::Leased(held) = &mut self.jobs[key.job as usize].state {
            held.deadline = until;
        }
        holds
    }

    /// Ends a job; returns the worker that held it.
    pub(super) fn finish(&mut self, index: u32, records: Digest) -> Option<WorkerId> {
        let job = &mut self.jobs[index as usize];
        self.pending.remove(&(job.rank, index));
        self.leased.remove(&index);
        match std::mem::replace(&mut job.state, State::Done(records)) {
            State::Leased(held) => Some(held.worker),
            _ => None,
        }
    }

    pub(super) fn hand_back(&mut self, key: &LeaseKey) {
        if self.holds(key) {
            self.free(key.job);
        }
    }

    /// Reasons of all failed attempts, with that of the one that holds the lease; None if it does not hold it.
    pub(super) fn reasons_with(&self, key: &LeaseKey, reason: &str) -> Option<Vec<String>> {
        let job = self.jobs.get(key.job as usize).filter(|_| self.holds(key))?;
        let this = format!("attempt {}: {reason}", key.attempt);
        Some(job.reasons.iter().cloned().chain([this]).collect())
    }

    /// Ends the attempt that holds the lease: the job is given up for the reasons given, or pending again.
    pub(super) fn fail(&mut self, key: &LeaseKey, reason: &str, give_up: Option<String>) {
        let Some(reasons) = self.reasons_with(key, reason) else { return };
        let job = &mut self.jobs[key.job as usize];
        job.reasons = reasons;
        match give_up {
            None => self.free(key.job),
            Some(reasons) => {
                job.state = State::Failed(reasons);
                self.leased.remove(&key.job);
            }
        }
    }

    pub(super) fn free_leases_of(&mut self, worker: &WorkerId) {
        let held: Vec<u32> =
            self.leased.iter().copied().filter(|job| self.is_held_by(*job, worker)).collect();
        for job in held {
            self.free(job);
        }
    }

    /// Gives out no more of its jobs.
    pub fn suspend(&mut self) {
        self.pending.clear();
    }

    /// Frees leases past their deadline. A worker that fell silent is not counted as the job's failure.
    pub(super) fn expire(&mut self, now: Duration) -> usize {
        let past = |job: &u32| match &self.jobs[*job as usize].state {
            State::Leased(held) => held.deadline <= now,
            _ => false,
        };
        let late: Vec<u32> = self.leased.iter().copied().filter(past).collect();
        for job in &late {
            self.free(*job);
        }
        late.len()
    }

    fn free(&mut self, index: u32) {
        let job = &mut self.jobs[index as usize];
        job.state = State::Pending;
        self.leased.remove(&index);
        self.pending.insert((job.rank, index));
    }
}
