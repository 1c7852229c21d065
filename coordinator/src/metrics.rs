//! Serves metrics and health over plain HTTP, on a separate port: `/metrics`, `/livez`, `/readyz`.
//!
//! A client that can reach the port can read the names of dictionaries and their progress; it can change nothing.

mod counters;
mod exposition;
mod process;
mod snapshot;

#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::header::{ACCEPT, CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinError, JoinSet};
use tokio_util::sync::CancellationToken;

use self::exposition::Format;

pub use self::counters::{BuildInfo, JobFailure, LeaseKind, Metrics, VerificationOutcome};
pub use self::snapshot::{DictionaryCounts, JobCounts, Snapshot, WorkerCounts};

/// Time limit for a request to arrive. A connection carries one: places are few, and probes need one soon.
const HEADER_TIMEOUT: Duration = Duration::from_secs(5);
/// Time limit of a connection whose other side does not read the answer.
const CONNECTION_TIMEOUT: Duration = Duration::from_secs(30);
/// Time limit of a running answer after the signal to stop.
const STOP_TIMEOUT: Duration = Duration::from_secs(1);
/// Largest number of connections, beyond which the oldest is closed: a probe is answered whatever else is connected.
const MOST_CONNECTIONS: usize = 64;
const BUFFER_BYTES: usize = 16_384;
const MOST_HEADERS: usize = 64;

const PATHS: &str = "not found; there are:
/metrics  metrics for Prometheus
/livez    whether the process answers
/readyz   whether it can serve
";

type Ask<T> = Arc<dyn Fn() -> T + Send + Sync>;

/// The server of the metrics port. Both closures are called for each request on a thread that serves others: they must
/// be quick.
#[derive(Clone)]
pub struct MetricsServer {
    metrics: Metrics,
    snapshot: Ask<Snapshot>,
    ready: Ask<Result<(), String>>,
}

impl MetricsServer {
    /// `ready` returns the reason if the caller cannot serve.
    pub fn new(
        metrics: Metrics,
        snapshot: impl Fn() -> Snapshot + Send + Sync + 'static,
        ready: impl Fn() -> Result<(), String> + Send + Sync + 'static,
    ) -> Self {
        Self { metrics, snapshot: Arc::new(snapshot), ready: Arc::new(ready) }
    }
}

impl fmt::Debug for MetricsServer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MetricsServer").field("metrics", &self.metrics).finish_non_exhaustive()
    }
}

/// Serves until the token is cancelled, and then ends within two seconds, whatever is connected.
pub async fn serve(listener: TcpListener, state: MetricsServer, shutdown: CancellationToken) {
    let router = router(state);
    let mut connections = JoinSet::new();
    let mut oldest_first: VecDeque<AbortHandle> = VecDeque::new();
    loop {
        tokio::select! {
            () = shutdown.cancelled() => break,
            Some(ended) = connections.join_next() => report(ended),
            stream = accept(&listener) => {
                oldest_first.retain(|connection| !connection.is_finished());
                if oldest_first.len() >= MOST_CONNECTIONS
                    && let Some(oldest) = oldest_first.pop_front()
                {
                    oldest.abort();
                }
                oldest_first.push_back(connections.spawn(converse(stream, router.clone(), shutdown.clone())));
            }
        }
    }
    drop(listener);
    // Answers that are still running are cut off. A closure of the caller that hangs ends with the process.
    let _ = tokio::time::timeout(STOP_TIMEOUT, async {
        while let Some(ended) = connections.join_next().await {
            report(ended);
        }
    })
    .await;
}

fn router(state: MetricsServer) -> Router {
    Router::new()
        .route("/metrics", get(metrics))
        .route("/livez", get(|| async { "ok" }))
        .route("/readyz", get(ready))
        .fallback(|| async { (StatusCode::NOT_FOUND, PATHS) })
        .with_state(state)
}

async fn metrics(State(state): State<MetricsServer>, headers: HeaderMap) -> Response {
    let accepted = headers.get_all(ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let format = Format::best_of(accepted);
    match state.metrics.expose((state.snapshot)(), format) {
        Ok(text) => {
            ([(CONTENT_TYPE, format.content_type()), (CACHE_CONTROL, "no-store")], text).into_response()
        }
        // Writing to a string does not fail; a metric that breaks the library's rules would.
        Err(error) => {
            (StatusCode::INTERNAL_SERVER_ERROR, format!("writing the metrics: {error}\n")).into_response()
        }
    }
}

async fn ready(State(state): State<MetricsServer>) -> Response {
    match (state.ready)() {
        Ok(()) => "ok".into_response(),
        Err(reason) => (StatusCode::SERVICE_UNAVAILABLE, reason).into_response(),
    }
}

async fn accept(listener: &TcpListener) -> TcpStream {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => return stream,
            Err(error) => {
                tracing::warn!(%error, "metrics port: a connection was not accepted");
                // Without free file descriptors, for example, an immediate retry would only use processor time.
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

async fn converse(stream: TcpStream, router: Router, shutdown: CancellationToken) {
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .keep_alive(false)
        .header_read_timeout(HEADER_TIMEOUT)
        .max_buf_size(BUFFER_BYTES)
        .max_headers(MOST_HEADERS)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router));
    let mut connection = std::pin::pin!(connection);
    let ended = tokio::select! {
        ended = tokio::time::timeout(CONNECTION_TIMEOUT, connection.as_mut()) => ended,
        () = shutdown.cancelled() => {
            connection.as_mut().graceful_shutdown();
            Ok(connection.await)
        }
    };
    if let Ok(Err(error)) = ended {
        tracing::debug!(%error, "metrics port: a connection broke");
    }
}

fn report(ended: Result<(), JoinError>) {
    if let Err(error) = ended
        && !error.is_cancelled()
    {
        tracing::error!(%error, "metrics port: an answer failed");
    }
}
