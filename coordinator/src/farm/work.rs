//! What workers ask for: leases, renewals, and the way of a result from the wire to the disk.

use std::sync::PoisonError;

use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::job::{JobSpec, LeaseKey};
use farm_proto::{Digest, PHYSICS_VERSION, Record};

use super::{Farm, FarmError, Result, chance};
use crate::clock::random_token;
use crate::dispatch::{
    Admission, Arrived, Dictionary, Effect, EventKind, Grant, Origin, Purpose, Registration, Settings,
};
use crate::store::{Completion, Content, StoreError, Stored};
use crate::web::{JobFailure, JobOutcome, LeaseKind, VerificationOutcome};

/// The content of a result, as it came in.
#[derive(Debug)]
pub(crate) enum Received {
    Records(Vec<Record>),
    Sums(Vec<u8>),
}

/// What became of a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    Stored,
    Duplicate,
    Conflict,
    /// Its dictionary was deleted or its worker fenced off while it was on its way, or it is there already.
    Unwanted,
}

impl Received {
    fn digest(&self) -> Digest {
        match self {
            Self::Records(records) => Digest::of_records(records),
            Self::Sums(bytes) => Digest::of_bytes(bytes),
        }
    }
}

impl Farm {
    pub(crate) async fn register(
        &self,
        instance: &str,
        about: Registration,
        physics_version: u32,
    ) -> Result<(WorkerId, Settings)> {
        if physics_version != PHYSICS_VERSION {
            return Err(FarmError::PhysicsVersion { found: physics_version });
        }
        let origin = Origin(self.store.worker(instance, &about.label).await?);
        let id = WorkerId(random_token());
        let settings = {
            let mut dispatch = self.dispatch();
            dispatch.register(self.clock.now(), id.clone(), origin, about)?;
            dispatch.settings()
        };
        self.settle().await;
        // It may have held leases before it forgot them.
        self.work.send_replace(());
        Ok((id, settings))
    }

    pub(crate) fn acquire(&self, worker: &WorkerId, max: usize) -> Result<Grant> {
        let grant = self.dispatch().acquire(self.clock.now(), worker, max, &mut chance())?;
        for purpose in &grant.purposes {
            let kind = match purpose {
                Purpose::First => LeaseKind::First,
                Purpose::Retry => LeaseKind::Retry,
                Purpose::Copy => LeaseKind::Speculative,
                Purpose::Check => LeaseKind::Verification,
            };
            self.metrics.leases_granted(kind, 1);
        }
        Ok(grant)
    }

    /// Extends leases: those that are lost, and whether the worker is to leave.
    pub(crate) fn renew(
        &self,
        worker: &WorkerId,
        leases: Vec<(LeaseKey, bool, Digest)>,
    ) -> Result<(Vec<LeaseKey>, bool)> {
        Ok(self.dispatch().renew(self.clock.now(), worker, leases)?)
    }

    /// Whether a result is wanted, and what it must look like.
    pub(crate) fn admit(&self, worker: &WorkerId, key: &LeaseKey, identity: Digest) -> Result<Admission> {
        Ok(self.dispatch().admit(self.clock.now(), worker, key, identity)?)
    }

    /// Stores a result, or compares it with what is stored.
    pub(crate) async fn complete(
        &self,
        worker: WorkerId,
        key: LeaseKey,
        admission: Admission,
        received: Received,
    ) -> Result<Outcome> {
        let outcome = match admission {
            Admission::Store { job, by } => {
                let arrived = Arrived { worker: &worker, by, key: &key, walks: job.walks() };
                self.store_result(&arrived, job.clone(), received).await?
            }
            Admission::Compare { by, stored, .. } => self.compare(by, &key, stored, received.digest()),
            Admission::Repeated { .. } => Outcome::Duplicate,
        };
        self.settle().await;
        self.changed.send_replace(());
        match outcome {
            Outcome::Stored => self.metrics.job_completed(JobOutcome::Stored),
            Outcome::Duplicate => self.metrics.job_completed(JobOutcome::Duplicate),
            Outcome::Conflict => self.metrics.job_completed(JobOutcome::Conflict),
            Outcome::Unwanted => {}
        }
        Ok(outcome)
    }

    async fn store_result(&self, arrived: &Arrived<'_>, job: JobSpec, received: Received) -> Result<Outcome> {
        let key = arrived.key;
        let quality = self.dispatch().by_id(key.dictionary).and_then(|d| d.grid().quality());
        let digest = received.digest();
        let content = match received {
            Received::Records(records) => Content::Records(records),
            Received::Sums(bytes) => Content::Sums(bytes),
        };
        let completion = Completion {
            dictionary: key.dictionary,
            job_number: key.job,
            job,
            worker: arrived.by.0,
            content,
            quality,
        };
        let _nothing_is_forgotten = self.records.read().await;
        let stored = self.store.complete(completion).await;
        self.note_store_fault(stored.as_ref().err());
        let now = self.clock.now();
        match stored? {
            Stored::Finished { records } => {
                self.dispatch().finished(now, arrived, records, &mut chance());
                if self.dispatch().checks().2 > 0 {
                    self.work.send_replace(());
                }
            }
            Stored::Part => self.dispatch().part_finished(now, arrived),
            Stored::MoreWalks(walks) => {
                self.dispatch().prolong(now, arrived, walks);
                self.find_blocks_of(key).await?;
                self.work.send_replace(());
            }
            Stored::Unwanted => return Ok(Outcome::Unwanted),
            Stored::Before { records } => return Ok(self.compare(arrived.by, key, records, digest)),
        }
        Ok(Outcome::Stored)
    }

    async fn find_blocks_of(&self, key: &LeaseKey) -> Result<(), StoreError> {
        let job = self.dispatch().by_id(key.dictionary).map(|d| d.spec(key.job, 0));
        if let Some(job) = job.filter(|job| job.block().is_some()) {
            let blocks = self.store.stored_blocks(&job).await?;
            self.dispatch().parts_stored(key.dictionary, key.job, job.walks(), &blocks);
        }
        Ok(())
    }

    fn compare(&self, by: Origin, key: &LeaseKey, stored: Digest, new: Digest) -> Outcome {
        let mut dispatch = self.dispatch();
        let before = dispatch.checks();
        let equal = dispatch.compared(by, key, stored, new);
        let after = dispatch.checks();
        if after.0 > before.0 {
            self.metrics.verified(VerificationOutcome::Agreed);
        }
        if after.1 > before.1 {
            self.metrics.verified(VerificationOutcome::Disputed);
        }
        if equal { Outcome::Duplicate } else { Outcome::Conflict }
    }

    fn note_store_fault(&self, error: Option<&StoreError>) {
        let mut fault = self.store_fault.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(error) = error
            && fault.is_none()
        {
            tracing::error!(%error, "results cannot be stored: workers keep them and try again");
        }
        if error.is_none() && fault.is_some() {
            tracing::info!("results can be stored again");
        }
        *fault = error.map(ToString::to_string);
    }

    /// Takes leases back; a worker that leaves gives all of its leases back, also those it has not heard of.
    pub(crate) async fn hand_back(&self, worker: &WorkerId, leases: &[LeaseKey], leaving: bool) {
        {
            let mut dispatch = self.dispatch();
            dispatch.hand_back(leases);
            if leaving {
                dispatch.leave(worker);
            }
        }
        self.settle().await;
        self.work.send_replace(());
        self.changed.send_replace(());
    }

    pub(crate) async fn failed(&self, worker: &WorkerId, key: &LeaseKey, reason: &str) -> Result<()> {
        let counted = self.dispatch().failed(self.clock.now(), worker, key, reason);
        self.settle().await;
        self.work.send_replace(());
        self.changed.send_replace(());
        Ok(counted?)
    }

    /// Frees leases of workers that are silent.
    pub(crate) async fn expire(&self) -> usize {
        let (freed, copies) = {
            let mut dispatch = self.dispatch();
            (dispatch.expire(self.clock.now()), dispatch.wants_copies())
        };
        self.settle().await;
        self.metrics.leases_expired(freed as u64);
        if freed > 0 || copies {
            self.work.send_replace(());
            self.changed.send_replace(());
        }
        freed
    }

    /// Makes durable what the dispatcher has decided, and notes what has happened.
    pub(super) async fn settle(&self) {
        let mut failed = Vec::new();
        loop {
            let (effects, events) = {
                let mut dispatch = self.dispatch();
                let events: Vec<_> = dispatch.take_events();
                let named = events.into_iter().map(|event| {
                    let dictionary = event.dictionary.and_then(|id| dispatch.by_id(id));
                    (dictionary.map(|d| d.name().to_string()).unwrap_or_default(), event)
                });
                let named: Vec<_> = named.collect();
                (dispatch.take_effects(), named)
            };
            for (dictionary, event) in events {
                match event.kind {
                    EventKind::JobFailed => self.metrics.job_failed(JobFailure::Failed),
                    EventKind::JobQuarantined => self.metrics.job_failed(JobFailure::Quarantined),
                    _ => {}
                }
                self.recorder.record(&dictionary, &event);
            }
            if effects.is_empty() {
                self.dispatch().put_off(failed);
                return;
            }
            for effect in effects {
                if let Err(error) = self.perform(&effect).await {
                    tracing::error!(%error, "a decision could not be stored: it is tried again");
                    failed.push(effect);
                }
            }
            self.work.send_replace(());
            self.changed.send_replace(());
        }
    }

    async fn perform(&self, effect: &Effect) -> Result<(), StoreError> {
        match effect {
            Effect::GiveUp { dictionary, job, reason, quarantined } => {
                self.store.give_up_job(*dictionary, *job, reason, *quarantined).await
            }
            Effect::Recompute { dictionary, job } => self.forget_job(*dictionary, *job).await,
            Effect::Fence { worker, reason } => {
                let _no_result_on_its_way = self.records.write().await;
                let forgotten = self.store.fence(worker.0, reason).await?;
                self.reopen(forgotten);
                // Blocks of jobs that had not ended are gone too.
                let all: Vec<_> = self.dispatch().dictionaries().map(Dictionary::id).collect();
                for id in all {
                    self.find_blocks(id).await?;
                }
                Ok(())
            }
        }
    }

    /// Forgets the records of a job, and begins it again wherever they were used.
    pub(super) async fn forget_job(&self, dictionary: DictionaryId, job: u32) -> Result<(), StoreError> {
        let _no_result_on_its_way = self.records.write().await;
        let forgotten = self.store.forget_job(dictionary, job).await?;
        self.reopen(forgotten);
        Ok(())
    }

    /// Begins jobs again whose records the store has forgotten.
    fn reopen(&self, mut jobs: Vec<(DictionaryId, u32)>) {
        jobs.sort_unstable();
        let mut dispatch = self.dispatch();
        for of_one in jobs.chunk_by(|a, b| a.0 == b.0) {
            let numbers: Vec<u32> = of_one.iter().map(|(_, job)| *job).collect();
            dispatch.reopen(of_one[0].0, &numbers);
            self.fits.forget(of_one[0].0);
        }
    }
}
