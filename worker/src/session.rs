//! The client of `farm.v1.Leases`: registers the worker and makes its calls. Calls that must not be lost are repeated
//! until they are answered.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use farm_link::Link;
use farm_proto::lease::{HeldLease, Lease, LeaseKey};
use farm_proto::status::MachineFacts;
use farm_proto::wire::leases_client::LeasesClient;
use farm_proto::wire::{
    AcquireRequest, CompleteRequest, CompletionOutcome, FailRequest, HandBackRequest, RegisterRequest,
    RenewRequest,
};
use farm_proto::{PROTOCOL_VERSION, RequestLimits, to_status, wire};
use optics_model::{Digest, PHYSICS_VERSION};
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tonic::{Code, Response, Status};

use crate::kernels::UnknownKernel;
use crate::leases::HeldLeases;
use crate::reachability::Reachability;
use crate::retry::repeat;

/// Time limit of a call that neither carries records nor renews leases.
const CALL: Duration = Duration::from_mins(1);
/// Time limit of the announcement that jobs begin.
const BEGIN: Duration = Duration::from_millis(500);
/// Time limit of deregistration, for which the end of the process waits.
const LEAVE: Duration = Duration::from_secs(5);

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("the coordinator refused this worker: {}", .0.message())]
    Refused(Status),
    #[error(transparent)]
    Kernel(#[from] UnknownKernel),
    #[error("starting the tracing threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// Properties of the worker that it sends when it registers.
#[derive(Debug, Clone)]
pub(crate) struct Introduction {
    pub label: String,
    /// Identifies this machine.
    pub host: String,
    pub threads: usize,
    pub facts: MachineFacts,
}

/// The coordinator's answer to the last registration.
#[derive(Debug, Clone, Default)]
struct SessionRegistration {
    worker_token: String,
    lease: Duration,
}

/// A registered connection. It registers again when the coordinator does not recognise the worker.
#[derive(Debug)]
pub(crate) struct CoordinatorSession {
    client: LeasesClient<Link>,
    introduction: Introduction,
    /// Random id of this process, equal in all its registrations.
    instance: String,
    registration: Mutex<SessionRegistration>,
    /// Locked during a repeated registration: each one frees the leases of the one before.
    registering: tokio::sync::Mutex<()>,
    held: Arc<HeldLeases>,
    reachability: Reachability,
}

impl CoordinatorSession {
    /// Registers; waits for the coordinator at `url` without limit. None if `shutdown` comes first.
    pub(crate) async fn open(
        link: Link,
        url: &str,
        introduction: Introduction,
        held: Arc<HeldLeases>,
        shutdown: &CancellationToken,
    ) -> Result<Option<Self>, Error> {
        let session = Self {
            client: LeasesClient::new(link)
                .max_decoding_message_size(RequestLimits::MESSAGE_BYTES)
                .max_encoding_message_size(RequestLimits::MESSAGE_BYTES),
            introduction,
            instance: instance(),
            registration: Mutex::default(),
            registering: tokio::sync::Mutex::default(),
            held,
            reachability: Reachability::new(url),
        };
        tokio::select! {
            registered = repeat(session.back(), || session.register()) => registered.map_err(Error::Refused)?,
            () = shutdown.cancelled() => return Ok(None),
        }
        Ok(Some(session))
    }

    /// Time for which a lease is valid without renewal.
    pub(crate) fn lease(&self) -> Duration {
        self.registration().lease
    }

    /// Notifies when calls that failed may succeed.
    pub(crate) fn back(&self) -> watch::Receiver<()> {
        self.reachability.back()
    }

    pub(crate) fn url(&self) -> &str {
        self.reachability.url()
    }

    /// Waits up to `wait` for jobs, each together with those that share its walks. The flag is true if the worker
    /// should leave.
    pub(crate) async fn acquire(&self, max: usize, wait: Duration) -> Result<(Vec<Lease>, bool), Status> {
        // Between a registration and the announcement that follows, the worker could be leased its own jobs.
        drop(self.registering.lock().await);
        let worker_token = self.worker_token();
        let request = AcquireRequest {
            worker_token: worker_token.clone(),
            max_leases: max.min(RequestLimits::LEASES as usize) as u32,
            wait_ms: wait.as_millis() as u64,
            whole_sets: true,
        };
        let answer = self.call(self.client.clone().acquire(timed(request, CALL))).await;
        let answer = self.reregister_if_unknown(&worker_token, answer).await?;
        let leases =
            answer.leases.into_iter().map(|l| Lease::try_from(l).map_err(|invalid| to_status(&invalid)));
        Ok((leases.collect::<Result<_, _>>()?, answer.drain))
    }

    /// Extends leases; returns the lost ones, and whether the worker should leave.
    pub(crate) async fn renew(&self, leases: Vec<HeldLease>) -> Result<(Vec<LeaseKey>, bool), Status> {
        let worker_token = self.worker_token();
        let mut leases: Vec<wire::HeldLease> = leases.into_iter().map(Into::into).collect();
        let (mut lost, mut drain) = (Vec::new(), false);
        // Also without leases, as a sign of life.
        loop {
            let rest = leases.split_off(leases.len().min(RequestLimits::LEASES as usize));
            let request = RenewRequest { worker_token: worker_token.clone(), leases };
            // A late heartbeat is useless.
            let answer = self.call(self.client.clone().renew(timed(request, self.lease() / 2))).await;
            let answer = self.reregister_if_unknown(&worker_token, answer).await?;
            lost.extend(answer.lost.into_iter().map(LeaseKey::from));
            drain |= answer.drain;
            leases = rest;
            if leases.is_empty() {
                return Ok((lost, drain));
            }
        }
    }

    /// Announces that jobs begin, so that they can be identified as the cause if this process dies at once.
    pub(crate) async fn begin(&self, jobs: Vec<(LeaseKey, Digest)>) {
        let Some(job) = jobs.first().map(|(key, _)| key.job) else { return };
        let lease = |(key, identity)| HeldLease { key, running: true, identity }.into();
        let leases = jobs.into_iter().map(lease).collect();
        let request = RenewRequest { worker_token: self.worker_token(), leases };
        let mut client = self.client.clone();
        let announced = client.renew(timed(request, BEGIN));
        if let Ok(Err(status)) = tokio::time::timeout(BEGIN, announced).await {
            tracing::debug!(job, message = status.message(), "the start of a job could not be announced");
        }
    }

    /// Delivers results until they are acknowledged or refused for good. `messages` builds the messages of a call with
    /// the worker's token; a call may take `limit`.
    pub(crate) async fn complete(
        &self,
        messages: impl Fn(&str) -> Vec<CompleteRequest>,
        limit: Duration,
    ) -> Result<Vec<CompletionOutcome>, Status> {
        repeat(self.back(), || async {
            let worker_token = self.worker_token();
            let messages = tokio_stream::iter(messages(&worker_token));
            let answer = self.call(self.client.clone().complete(timed(messages, limit))).await;
            Ok(self.reregister_if_unknown(&worker_token, answer).await?.outcomes)
        })
        .await
    }

    /// Reports that a job could not be computed.
    pub(crate) async fn fail(&self, key: &LeaseKey, reason: &str) -> Result<(), Status> {
        repeat(self.back(), || async {
            let worker_token = self.worker_token();
            let lease = Some((*key).into());
            let request =
                FailRequest { worker_token: worker_token.clone(), lease, reason: reason.to_owned() };
            let answer = self.call(self.client.clone().fail(timed(request, CALL))).await;
            self.reregister_if_unknown(&worker_token, answer).await.map(drop)
        })
        .await
    }

    /// Hands leases back and announces that the worker stops. It is tried once: if it fails, the leases expire.
    pub(crate) async fn stop(&self, leases: Vec<LeaseKey>) -> Result<(), Status> {
        self.hand_back(leases, false).await
    }

    /// Hands all leases back and deregisters. It is tried once: if it fails, the leases expire.
    pub(crate) async fn leave(&self, leases: Vec<LeaseKey>) -> Result<(), Status> {
        self.hand_back(leases, true).await
    }

    async fn hand_back(&self, leases: Vec<LeaseKey>, leaving: bool) -> Result<(), Status> {
        let leases = leases.into_iter().map(Into::into).collect();
        let request = HandBackRequest { worker_token: self.worker_token(), leases, leaving, stopping: true };
        self.call(self.client.clone().hand_back(timed(request, LEAVE))).await.map(drop)
    }

    /// Makes a call, and records whether it was answered.
    async fn call<T>(&self, call: impl Future<Output = Result<Response<T>, Status>>) -> Result<T, Status> {
        let began = Instant::now();
        let answer = call.await;
        self.reachability.note(began, answer.as_ref().err());
        answer.map(Response::into_inner)
    }

    async fn register(&self) -> Result<(), Status> {
        let Introduction { label, host, threads, facts } = &self.introduction;
        let request = RegisterRequest {
            label: label.clone(),
            host: host.clone(),
            threads: *threads as u32,
            physics_version: PHYSICS_VERSION,
            protocol_version: PROTOCOL_VERSION,
            instance: self.instance.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            facts: Some(facts.clone().into()),
        };
        let response = self.call(self.client.clone().register(timed(request, CALL))).await?;
        self.reachability.joined(label, *threads);
        let lease = Duration::from_millis(response.lease_ms);
        *self.registration() = SessionRegistration { worker_token: response.worker_token, lease };
        Ok(())
    }

    /// Registers again if the answer to a call with this token is that the worker is unknown.
    async fn reregister_if_unknown<T>(
        &self,
        worker_token: &str,
        answer: Result<T, Status>,
    ) -> Result<T, Status> {
        if answer.as_ref().is_err_and(|status| status.code() == Code::Aborted) {
            let _one_at_a_time = self.registering.lock().await;
            if worker_token == self.worker_token() {
                tracing::warn!("this worker is unknown to the coordinator: registering again");
                self.register().await?;
                self.announce().await;
                self.reachability.joined_again();
            }
        }
        answer
    }

    /// Announces the leases of this worker to a restarted coordinator before it requests more: otherwise it could be
    /// leased its own jobs again.
    async fn announce(&self) {
        let SessionRegistration { worker_token, lease } = self.registration().clone();
        let mut leases = self.held.all().into_iter().map(wire::HeldLease::from).peekable();
        while leases.peek().is_some() {
            let leases = leases.by_ref().take(RequestLimits::LEASES as usize).collect();
            let request = RenewRequest { worker_token: worker_token.clone(), leases };
            // The next heartbeat finds out which leases are lost.
            if let Err(status) = self.call(self.client.clone().renew(timed(request, lease / 2))).await {
                tracing::warn!(message = status.message(), "leases could not be announced");
                return;
            }
        }
    }

    fn worker_token(&self) -> String {
        self.registration().worker_token.clone()
    }

    fn registration(&self) -> MutexGuard<'_, SessionRegistration> {
        self.registration.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn timed<T>(message: T, limit: Duration) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.set_timeout(limit);
    request
}

/// 128 random bits, in hexadecimal.
fn instance() -> String {
    let mut bytes = [0_u8; 16];
    if getrandom::fill(&mut bytes).is_err() {
        // Without randomness, the process number is used instead.
        bytes[..4].copy_from_slice(&std::process::id().to_le_bytes());
    }
    format!("{:032x}", u128::from_be_bytes(bytes))
}

#[cfg(test)]
mod tests;
