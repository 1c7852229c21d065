//! The worker's side of `farm.v1.Leases`: registration, and calls that are repeated until they get an answer.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use backon::{ExponentialBuilder, Retryable};
use farm_proto::job::{Lease, LeaseKey};
use farm_proto::wire::complete_request::Part;
use farm_proto::wire::leases_client::LeasesClient;
use farm_proto::wire::{
    AcquireRequest, CompleteRequest, FailRequest, HandBackRequest, RegisterRequest, RenewRequest,
};
use farm_proto::{PHYSICS_VERSION, Profile, Record, RequestLimits};
use tokio_util::sync::CancellationToken;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};

use crate::config::Config;

/// Longest time a call may take that neither carries records nor holds leases.
const CALL: Duration = Duration::from_mins(1);
/// Longest time to take leave: whoever stops a worker waits for it.
const LEAVE: Duration = Duration::from_secs(5);
/// Slowest link, in bytes a second, over which records are delivered before the call is given up and repeated.
const SLOWEST: f64 = 50_000.0;
/// HTTP/2 pings find links that were cut without a word.
const KEEPALIVE: Duration = Duration::from_secs(20);

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("coordinator URL {url:?} is not valid: {source}")]
    Url { url: String, source: tonic::transport::Error },
    #[error("the coordinator refused this worker: {}", .0.message())]
    Refused(Status),
    #[error("starting the tracing threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// A registered connection. Registers anew by itself when the coordinator has forgotten the worker.
#[derive(Debug)]
pub(crate) struct Session {
    client: LeasesClient<Channel>,
    config: Config,
    worker_id: Mutex<String>,
    lease: Duration,
}

impl Session {
    /// Connects and registers, waiting for the coordinator as long as it takes; None if `shutdown` comes first.
    pub(crate) async fn open(config: Config, shutdown: &CancellationToken) -> Result<Option<Self>, Error> {
        let endpoint = Endpoint::from_shared(config.coordinator.clone())
            .map_err(|source| Error::Url { url: config.coordinator.clone(), source })?
            .connect_timeout(Duration::from_secs(10))
            .http2_keep_alive_interval(KEEPALIVE)
            .keep_alive_timeout(KEEPALIVE)
            .tcp_nodelay(true);
        let client = LeasesClient::new(endpoint.connect_lazy())
            .max_decoding_message_size(RequestLimits::MESSAGE_BYTES)
            .max_encoding_message_size(RequestLimits::MESSAGE_BYTES);
        let mut session = Self { client, config, worker_id: Mutex::default(), lease: Duration::ZERO };
        let registered = tokio::select! {
            registered = repeat(|| session.register()) => registered.map_err(Error::Refused)?,
            () = shutdown.cancelled() => return Ok(None),
        };
        session.lease = registered;
        Ok(Some(session))
    }

    /// How long a lease holds without renewal.
    pub(crate) fn lease(&self) -> Duration {
        self.lease
    }

    async fn register(&self) -> Result<Duration, Status> {
        let request = RegisterRequest {
            label: self.config.label.clone(),
            threads: self.config.threads as u32,
            physics_version: PHYSICS_VERSION,
        };
        let response = self.client.clone().register(timed(request, CALL)).await?.into_inner();
        *self.worker_id.lock().unwrap_or_else(PoisonError::into_inner) = response.worker_id;
        Ok(Duration::from_millis(response.lease_ms))
    }

    fn worker_id(&self) -> String {
        self.worker_id.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Registers again if that is what an answer asks for.
    async fn known<T>(&self, answer: Result<T, Status>) -> Result<T, Status> {
        if let Err(status) = &answer
            && status.code() == Code::Unauthenticated
        {
            tracing::warn!("the coordinator does not know this worker: registering again");
            self.register().await?;
        }
        answer
    }

    /// Waits up to `wait` for jobs.
    pub(crate) async fn acquire(&self, max: usize, wait: Duration) -> Result<Vec<Lease>, Status> {
        let request = AcquireRequest {
            worker_id: self.worker_id(),
            max_leases: max.min(RequestLimits::LEASES as usize) as u32,
            wait_ms: wait.as_millis() as u64,
        };
        let answer = self.client.clone().acquire(timed(request, CALL)).await;
        let leases = self.known(answer).await?.into_inner().leases;
        leases.into_iter().map(|l| Lease::try_from(l).map_err(|e| e.to_status())).collect()
    }

    /// Extends leases; returns those that are lost.
    pub(crate) async fn renew(&self, leases: Vec<LeaseKey>) -> Result<Vec<LeaseKey>, Status> {
        let leases = leases.into_iter().map(Into::into).collect();
        let request = RenewRequest { worker_id: self.worker_id(), leases };
        // A call that is stuck must leave time for another before the leases end.
        let answer = self.client.clone().renew(timed(request, self.lease / 4)).await;
        Ok(self.known(answer).await?.into_inner().lost.into_iter().map(Into::into).collect())
    }

    /// Delivers records until they are acknowledged or refused for good.
    pub(crate) async fn complete(&self, key: &LeaseKey, records: &[Record]) -> Result<(), Status> {
        let estimates = records.iter().flat_map(|r| &r.profiles).flat_map(Profile::estimates);
        let bytes = estimates.map(|e| 8 * e.values().len());
        let limit = CALL + Duration::from_secs_f64(bytes.sum::<usize>() as f64 / SLOWEST);
        repeat(|| async {
            let lease = CompleteRequest { part: Some(Part::Lease(key.clone().into())) };
            let part = |r: &Record| CompleteRequest { part: Some(Part::Record(r.clone().into())) };
            let parts: Vec<_> = std::iter::once(lease).chain(records.iter().map(part)).collect();
            let answer = self.client.clone().complete(timed(tokio_stream::iter(parts), limit)).await?;
            if answer.into_inner().duplicate {
                tracing::info!(job = key.job, attempt = key.attempt, "these records were stored before");
            }
            Ok(())
        })
        .await
    }

    pub(crate) async fn fail(&self, key: &LeaseKey, reason: &str) -> Result<(), Status> {
        repeat(|| async {
            let lease = Some(key.clone().into());
            let request = FailRequest { worker_id: self.worker_id(), lease, reason: reason.to_owned() };
            self.client.clone().fail(timed(request, CALL)).await.map(drop)
        })
        .await
    }

    /// Hands all leases back for good. One try: if it does not get through, they expire by themselves.
    pub(crate) async fn leave(&self, leases: Vec<LeaseKey>) -> Result<(), Status> {
        let leases = leases.into_iter().map(Into::into).collect();
        let request = HandBackRequest { worker_id: self.worker_id(), leases, leaving: true };
        self.client.clone().hand_back(timed(request, LEAVE)).await.map(drop)
    }
}

fn timed<T>(message: T, limit: Duration) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.set_timeout(limit);
    request
}

/// Whether the same call may succeed later.
pub(crate) fn is_passing(status: &Status) -> bool {
    matches!(
        status.code(),
        Code::Unavailable
            | Code::DeadlineExceeded
            | Code::Aborted
            | Code::Cancelled
            | Code::Internal
            | Code::ResourceExhausted
            | Code::Unknown
    )
}

/// Calls until the answer is not a passing fault, with growing pauses of random length.
async fn repeat<T, F: Future<Output = Result<T, Status>>>(call: impl FnMut() -> F) -> Result<T, Status> {
    let pauses = ExponentialBuilder::default()
        .with_min_delay(Duration::from_millis(100))
        .with_max_delay(Duration::from_secs(10))
        .with_jitter()
        .without_max_times();
    call.retry(pauses)
        .when(is_passing)
        .notify(|status, pause| {
            tracing::warn!(code = ?status.code(), message = status.message(), ?pause, "the call is repeated");
        })
        .await
}
