//! The worker's side of `farm.v1.Leases`: registration, and calls that are repeated until they get an answer.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use farm_link::Link;
use farm_proto::lease::{Lease, LeaseKey};
use farm_proto::status::MachineFacts;
use farm_proto::wire::leases_client::LeasesClient;
use farm_proto::wire::{
    AcquireRequest, CompleteRequest, CompletionOutcome, FailRequest, HandBackRequest, HeldLease,
    RegisterRequest, RenewRequest,
};
use farm_proto::{PROTOCOL_VERSION, RequestLimits, to_status};
use optics_model::{Digest, PHYSICS_VERSION};
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tonic::{Code, Response, Status};

use crate::kernels::UnknownKernel;
use crate::leases::HeldLeases;
use crate::reachability::Reachability;
use crate::retry::repeat;

/// Longest time a call may take that neither carries records nor holds leases.
const CALL: Duration = Duration::from_mins(1);
/// Longest time that it is tried to tell that a job begins.
const TELL: Duration = Duration::from_millis(500);
/// Longest time that leaving may take: whoever stops a worker waits for it.
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

/// What a worker says of itself when it registers.
#[derive(Debug, Clone)]
pub(crate) struct Introduction {
    pub label: String,
    /// Tells this machine from others.
    pub host: String,
    pub threads: usize,
    pub facts: MachineFacts,
}

/// What the coordinator answered to the last registration.
#[derive(Debug, Clone, Default)]
struct Registration {
    worker_token: String,
    lease: Duration,
}

/// A registered connection. Registers anew by itself when the coordinator has forgotten the worker.
#[derive(Debug)]
pub(crate) struct Session {
    client: LeasesClient<Link>,
    introduction: Introduction,
    /// Tells the coordinator that this is the same process when it registers again.
    instance: String,
    registration: Mutex<Registration>,
    /// Held while the worker registers again: every registration frees the leases of the one before.
    registering: tokio::sync::Mutex<()>,
    held: Arc<HeldLeases>,
    reachability: Reachability,
}

impl Session {
    /// Registers, waiting for the coordinator at `url` as long as it takes; None if `shutdown` comes first.
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

    /// How long a lease holds without renewal.
    pub(crate) fn lease(&self) -> Duration {
        self.registration().lease
    }

    /// Changes from now on when calls that failed may succeed.
    pub(crate) fn back(&self) -> watch::Receiver<()> {
        self.reachability.back()
    }

    pub(crate) fn url(&self) -> &str {
        self.reachability.url()
    }

    /// Waits up to `wait` for jobs, and with each those that share its walks; tells also whether the worker is to leave.
    pub(crate) async fn acquire(&self, max: usize, wait: Duration) -> Result<(Vec<Lease>, bool), Status> {
        // Between a registration and the announcement that follows, it could be given its own jobs.
        drop(self.registering.lock().await);
        let worker_token = self.worker_token();
        let request = AcquireRequest {
            worker_token: worker_token.clone(),
            max_leases: max.min(RequestLimits::LEASES as usize) as u32,
            wait_ms: wait.as_millis() as u64,
            whole_sets: true,
        };
        let answer = self.call(self.client.clone().acquire(timed(request, CALL))).await;
        let answer = self.known(&worker_token, answer).await?;
        let leases =
            answer.leases.into_iter().map(|l| Lease::try_from(l).map_err(|invalid| to_status(&invalid)));
        Ok((leases.collect::<Result<_, _>>()?, answer.drain))
    }

    /// Extends leases; returns those that are lost, and whether the worker is to leave.
    pub(crate) async fn renew(
        &self,
        leases: Vec<(LeaseKey, bool, Digest)>,
    ) -> Result<(Vec<LeaseKey>, bool), Status> {
        let worker_token = self.worker_token();
        let mut leases: Vec<HeldLease> = leases.into_iter().map(on_wire).collect();
        let (mut lost, mut drain) = (Vec::new(), false);
        // Also without leases: a worker must be heard of.
        loop {
            let rest = leases.split_off(leases.len().min(RequestLimits::LEASES as usize));
            let request = RenewRequest { worker_token: worker_token.clone(), leases };
            // A heartbeat that comes late is worth nothing.
            let answer = self.call(self.client.clone().renew(timed(request, self.lease() / 2))).await;
            let answer = self.known(&worker_token, answer).await?;
            lost.extend(answer.lost.into_iter().map(LeaseKey::from));
            drain |= answer.drain;
            leases = rest;
            if leases.is_empty() {
                return Ok((lost, drain));
            }
        }
    }

    /// Tells that jobs begin, so that they can be blamed if they make this process die at once.
    pub(crate) async fn begin(&self, jobs: Vec<(LeaseKey, Digest)>) {
        let Some(job) = jobs.first().map(|(key, _)| key.job) else { return };
        let leases = jobs.into_iter().map(|(key, identity)| on_wire((key, true, identity))).collect();
        let request = RenewRequest { worker_token: self.worker_token(), leases };
        let mut client = self.client.clone();
        let told = client.renew(timed(request, TELL));
        if let Ok(Err(status)) = tokio::time::timeout(TELL, told).await {
            tracing::debug!(job, message = status.message(), "that a job begins could not be told");
        }
    }

    /// Delivers results until they are acknowledged or refused for good. `parts` makes the messages for a
    /// worker's token; a call may take `limit`.
    pub(crate) async fn complete(
        &self,
        parts: impl Fn(&str) -> Vec<CompleteRequest>,
        limit: Duration,
    ) -> Result<Vec<CompletionOutcome>, Status> {
        repeat(self.back(), || async {
            let worker_token = self.worker_token();
            let parts = tokio_stream::iter(parts(&worker_token));
            let answer = self.call(self.client.clone().complete(timed(parts, limit))).await;
            Ok(self.known(&worker_token, answer).await?.outcomes)
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
            self.known(&worker_token, answer).await.map(drop)
        })
        .await
    }

    /// Hands leases back, and says that the worker was asked to stop. One try: if it does not get through, they expire.
    pub(crate) async fn stop(&self, leases: Vec<LeaseKey>) -> Result<(), Status> {
        self.hand_back(leases, false).await
    }

    /// Hands all leases back for good. One try: if it does not get through, they expire.
    pub(crate) async fn leave(&self, leases: Vec<LeaseKey>) -> Result<(), Status> {
        self.hand_back(leases, true).await
    }

    async fn hand_back(&self, leases: Vec<LeaseKey>, leaving: bool) -> Result<(), Status> {
        let leases = leases.into_iter().map(Into::into).collect();
        let request = HandBackRequest { worker_token: self.worker_token(), leases, leaving, stopping: true };
        self.call(self.client.clone().hand_back(timed(request, LEAVE))).await.map(drop)
    }

    /// Makes a call, and notes whether there was an answer.
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
        *self.registration() = Registration { worker_token: response.worker_token, lease };
        Ok(())
    }

    /// Registers again if the answer to a call with this token asks for it.
    async fn known<T>(&self, worker_token: &str, answer: Result<T, Status>) -> Result<T, Status> {
        if answer.as_ref().is_err_and(|status| status.code() == Code::Aborted) {
            let _one_at_a_time = self.registering.lock().await;
            if worker_token == self.worker_token() {
                tracing::warn!("the coordinator does not know this worker: registering again");
                self.register().await?;
                self.announce().await;
                self.reachability.joined_again();
            }
        }
        answer
    }

    /// Tells a coordinator that was restarted what this worker has in hand, before it asks for more: otherwise it could
    /// be given its own jobs again.
    async fn announce(&self) {
        let Registration { worker_token, lease } = self.registration().clone();
        let mut leases = self.held.all().into_iter().map(on_wire).peekable();
        while leases.peek().is_some() {
            let leases = leases.by_ref().take(RequestLimits::LEASES as usize).collect();
            let request = RenewRequest { worker_token: worker_token.clone(), leases };
            // What is lost the next heartbeat finds out.
            if let Err(status) = self.call(self.client.clone().renew(timed(request, lease / 2))).await {
                tracing::warn!(message = status.message(), "leases could not be announced");
                return;
            }
        }
    }

    fn worker_token(&self) -> String {
        self.registration().worker_token.clone()
    }

    fn registration(&self) -> MutexGuard<'_, Registration> {
        self.registration.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn on_wire((key, running, identity): (LeaseKey, bool, Digest)) -> HeldLease {
    HeldLease { key: Some(key.into()), running, identity: identity.as_bytes().to_vec() }
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
        // Without randomness the process number must do.
        bytes[..4].copy_from_slice(&std::process::id().to_le_bytes());
    }
    format!("{:032x}", u128::from_be_bytes(bytes))
}

#[cfg(test)]
mod tests;
