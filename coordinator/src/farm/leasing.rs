//! Implements the operations of workers: registration, leases, renewals. A request for leases waits until there is work.

use std::time::Duration;

use farm_proto::PROTOCOL_VERSION;
use farm_proto::ids::WorkerId;
use farm_proto::lease::{HeldLease, LeaseKey};
use optics_model::{Digest, PHYSICS_VERSION};
use tokio_util::sync::CancellationToken;

use super::{Farm, FarmError, Result};
use crate::clock::{Random, random_token};
use crate::dispatch::{Admission, Dispatcher, Grant, LeaseRequest, Registration};

/// The way in which a worker ends.
#[derive(Debug, Clone, Copy)]
pub(crate) enum WorkerEnd {
    /// It was asked to stop, and has little time left.
    Stopping,
    Left,
}

/// The versions on which a worker and the coordinator must agree.
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
    /// The worker of a token, which it was issued at its registration and which others cannot read.
    pub(crate) fn verify_worker(&self, token: &str) -> Result<WorkerId> {
        Ok(self.scheduler.query(|dispatcher, _| dispatcher.roster().verify_worker(token))?)
    }

    /// The token that authenticates a worker in its calls.
    pub(crate) fn worker_token(&self, worker: &WorkerId) -> String {
        self.scheduler.query(|dispatcher, _| dispatcher.roster().worker_token(worker))
    }

    /// Registers a worker; returns its id and the duration of its leases.
    pub(crate) async fn register(
        &self,
        about: Registration,
        versions: Versions,
    ) -> Result<(WorkerId, Duration)> {
        versions.check()?;
        let origin = self.store.register_worker(&about.machine, &about.label).await?;
        let id = WorkerId(random_token());
        let lease = self
            .scheduler
            .transition(|dispatcher, now| dispatcher.register(now, id.clone(), origin, about))?;
        Ok((id, lease))
    }

    /// Grants leases; waits for work up to `patience`. None if none has come.
    pub(crate) async fn acquire(
        &self,
        worker: &WorkerId,
        request: impl Into<LeaseRequest>,
        patience: Duration,
        stop: &CancellationToken,
    ) -> Result<Option<Grant>> {
        let request = request.into();
        let patience = tokio::time::sleep(patience);
        tokio::pin!(patience);
        // Subscribed before the first look, so that no work is missed in between.
        let mut work = self.scheduler.work();
        loop {
            let grant = self.acquire_now(worker, request)?;
            if !grant.leases.is_empty() || grant.drain {
                return Ok(Some(grant));
            }
            tokio::select! {
                () = &mut patience => return Ok(None),
                () = stop.cancelled() => return Err(FarmError::Stopping),
                _ = work.changed() => {}
            }
        }
    }

    pub(super) fn acquire_now(&self, worker: &WorkerId, request: impl Into<LeaseRequest>) -> Result<Grant> {
        let acquire = self.scheduler.transition(|d, now| d.acquire(now, worker, request, &mut Random));
        Ok(acquire?)
    }

    /// Extends leases. Returns those that are lost, and whether the worker is to leave.
    pub(crate) fn renew(&self, worker: &WorkerId, leases: Vec<HeldLease>) -> Result<(Vec<LeaseKey>, bool)> {
        Ok(self.scheduler.transition(|dispatcher, now| dispatcher.renew(now, worker, leases))?)
    }

    /// Decides whether a result is accepted, and returns the job that it must match.
    pub(super) fn admit(&self, worker: &WorkerId, key: &LeaseKey, identity: Digest) -> Result<Admission> {
        Ok(self.scheduler.transition(|dispatcher, now| dispatcher.admit(now, worker, key, identity))?)
    }

    /// Takes leases back; a worker that leaves gives all of its leases back, including those whose grant it has not
    /// received.
    pub(crate) fn hand_back(&self, worker: &WorkerId, leases: &[LeaseKey], end: Option<WorkerEnd>) {
        self.scheduler.transition(|dispatcher, _| {
            dispatcher.hand_back(leases);
            match end {
                Some(WorkerEnd::Left) => dispatcher.leave(worker),
                Some(WorkerEnd::Stopping) => dispatcher.roster_mut().stopping(worker),
                None => {}
            }
        });
    }

    pub(crate) async fn failed(&self, worker: &WorkerId, key: &LeaseKey, reason: &str) -> Result<()> {
        let counted =
            self.scheduler.transition(|dispatcher, now| dispatcher.failed(now, worker, key, reason));
        self.scheduler.settled().await;
        Ok(counted?)
    }

    /// Performs the transitions that depend on time alone; returns the number of leases that were freed.
    pub(crate) fn look_over(&self) -> usize {
        self.scheduler.transition(Dispatcher::look_over)
    }
}
