//! What workers ask for: leases and renewals; and what follows from it for the store.

use farm_proto::PROTOCOL_VERSION;
use farm_proto::ids::{DictionaryId, WorkerId};
use farm_proto::lease::LeaseKey;
use optics_model::{Digest, PHYSICS_VERSION};

use super::{Farm, FarmError, Result, chance};
use crate::clock::random_token;
use crate::dispatch::{Admission, Dictionary, Effect, EventKind, Grant, Purpose, Registration, Settings};
use crate::metrics::{JobFailure, LeaseKind};
use crate::store::StoreError;

/// What a worker and the coordinator must agree on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Versions {
    pub physics: u32,
    pub protocol: u32,
}

impl Versions {
    fn check(self) -> Result<()> {
        let versions = [
            ("computes physics", self.physics, PHYSICS_VERSION),
            ("speaks protocol", self.protocol, PROTOCOL_VERSION),
        ];
        match versions.into_iter().find(|(_, found, own)| found != own) {
            Some((does, found, own)) => Err(FarmError::OtherVersion { does, found, own }),
            None => Ok(()),
        }
    }
}

impl Farm {
    pub(crate) async fn register(
        &self,
        instance: &str,
        about: Registration,
        versions: Versions,
    ) -> Result<(WorkerId, Settings)> {
        versions.check()?;
        let origin = self.store.register_worker(instance, &about.label).await?;
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
            Effect::Agreed { dictionary, job, worker } => {
                self.store.note_agreement(*dictionary, *job, *worker).await
            }
            Effect::Recompute { dictionary, job } => self.forget_job(*dictionary, *job).await,
            Effect::Fence { worker, reason } => {
                let _no_result_on_its_way = self.records.write().await;
                let forgotten = self.store.fence(*worker, reason).await?;
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
    pub(super) fn reopen(&self, mut jobs: Vec<(DictionaryId, u32)>) {
        jobs.sort_unstable();
        let mut dispatch = self.dispatch();
        for of_one in jobs.chunk_by(|a, b| a.0 == b.0) {
            let numbers: Vec<u32> = of_one.iter().map(|(_, job)| *job).collect();
            dispatch.reopen(of_one[0].0, &numbers);
            self.fits.forget(of_one[0].0);
        }
    }
}
