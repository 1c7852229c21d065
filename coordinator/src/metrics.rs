//! Serves metrics and health over plain HTTP, on a separate port: `/metrics`, `/livez`, `/readyz`.
//!
//! A client that can reach the port can read the names of dictionaries and their progress; it can change nothing.

mod counters;
mod exposition;
mod process;
mod snapshot;

#[cfg(test)]
mod tests;

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::header::{ACCEPT, CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use crate::connections::{Incoming, Limits, UnauthenticatedLimits};

use self::exposition::Format;

pub use self::counters::{BuildInfo, JobFailure, LeaseKind, Metrics, VerificationOutcome};
pub use self::snapshot::{DictionaryCounts, JobCounts, Snapshot, WorkerCounts};

/// Time limit of a connection: places are few, and probes need one soon.
const PATIENCE: Duration = Duration::from_secs(10);
/// Time limit of a running answer after the signal to stop.
const STOP_TIMEOUT: Duration = Duration::from_secs(1);
/// Largest number of connections. Of one address all but a few may be open: one more closes the oldest of them, so that a
/// probe is answered whatever else is connected.
const CONNECTIONS: usize = 1024;
const CONNECTIONS_OF_ONE: usize = 1000;

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
    let strangers = UnauthenticatedLimits { connections: CONNECTIONS_OF_ONE, patience: PATIENCE };
    let incoming = Incoming::new(listener, Limits::new(CONNECTIONS, Some(strangers)));
    let served =
        axum::serve(incoming, router(state)).with_graceful_shutdown(shutdown.clone().cancelled_owned());
    tokio::select! {
        _ = served => {}
        // Answers that are still running are cut off. A closure of the caller that hangs ends with the process.
        () = async {
            shutdown.cancelled().await;
            tokio::time::sleep(STOP_TIMEOUT).await;
        } => {}
    }
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
