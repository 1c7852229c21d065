//! Wraps every call with a request id, authorisation, and an observer.
//!
//! [`AuthorisationLayer`] surrounds all services (`Server::builder().layer(…)`), so that a service added later is
//! guarded by default: methods without a rule are for admins.

mod answer;
mod permission;
mod question;
mod request_id;

use std::fmt;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use http::header::AUTHORIZATION;
use http::{Request, Response};
use tonic::body::Body;
use tonic::{Code, Status};
use tower::{Layer, Service};
use tracing::Instrument as _;

use crate::clock::Clock;
use crate::connections::OpenConnection;
use crate::gate::Gate;
use crate::quota::{Held, Limit, Quota};
use crate::throttle::Throttle;

pub use permission::Caller;
pub(crate) use permission::{actor, machine};
pub use request_id::RequestId;

use answer::Call;
use permission::Admitted;

/// The method name with which calls are observed that no service has answered: callers may choose any path.
pub const OTHER_METHOD: &str = "other";

/// The method whose messages do not stay in memory: `farm/result_stream.rs` counts the results.
const STREAMED: &str = "/farm.v1.Leases/Complete";

/// Largest number of calls without a token that are under way on a connection at a time.
const OPEN_CALLS: u64 = 8;

/// Ratio of the bytes that all calls may hold to those of one caller.
const SHARES: u64 = 4;

/// Refused calls are logged at most this often.
const TELL_REFUSED: Duration = Duration::from_secs(10);

/// Makes services [`Authorised`]: calls need the tokens of the gate, if it has any.
#[derive(Debug, Clone)]
pub struct AuthorisationLayer {
    shared: Arc<Shared>,
}

type Observer = dyn Fn(&str, i32, Duration) + Send + Sync;

/// State that the services of all connections share.
struct Shared {
    gate: Gate,
    observer: Box<Observer>,
    clock: Clock,
    refused: Throttle,
    open_calls: Arc<Quota>,
    bytes: Arc<Quota>,
    held_bytes: u64,
}

impl AuthorisationLayer {
    /// `observer` is called once for every call, when it has ended, with the method's path or [`OTHER_METHOD`], the
    /// gRPC code (1, cancelled, if the caller has gone before the end), and the duration. The calls of one token may
    /// hold `held_bytes` bytes of questions that are not answered and of answers that are not read.
    pub fn new(
        gate: Gate,
        held_bytes: usize,
        observer: impl Fn(&str, i32, Duration) + Send + Sync + 'static,
    ) -> Self {
        let shared = Shared {
            gate,
            observer: Box::new(observer),
            clock: Clock::start(),
            refused: Throttle::new(TELL_REFUSED),
            open_calls: Quota::new(
                "calls at a time without a token",
                "wait for answers before the next call",
            ),
            bytes: Quota::new(
                "bytes of questions and unread answers",
                "wait for answers, and read them, before the next call",
            ),
            held_bytes: held_bytes as u64,
        };
        Self { shared: Arc::new(shared) }
    }
}

impl fmt::Debug for Shared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shared").field("gate", &self.gate).finish_non_exhaustive()
    }
}

impl<S> Layer<S> for AuthorisationLayer {
    type Service = Authorised<S>;

    fn layer(&self, inner: S) -> Authorised<S> {
        Authorised { inner, shared: self.shared.clone() }
    }
}

/// A service that only admitted calls reach. Handlers find [`RequestId`] and, where tokens are needed, [`Caller`] in
/// the extensions of their request.
#[derive(Debug, Clone)]
pub struct Authorised<S> {
    inner: S,
    shared: Arc<Shared>,
}

impl<S> Service<Request<Body>> for Authorised<S>
where
    S: Service<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(cx)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        let method = request.uri().path().to_owned();
        let id = RequestId::of(request.headers());
        let span = tracing::info_span!("call", %method, request_id = %id, caller = tracing::field::Empty);
        let mut call = Call::start(self.shared.clone(), method);
        let admitted = permission::admit(&self.shared.gate, &request)
            .and_then(|admitted| self.shared.let_in(admitted, &mut request));
        // Handlers do not need the token, and cannot log what they do not receive.
        request.headers_mut().remove(AUTHORIZATION);
        let mut means = match admitted {
            Ok(means) => means,
            Err(status) => {
                span.in_scope(|| self.shared.log_refused(&request, &status));
                call.refuse(&status);
                let mut response = status.into_http();
                id.put_into(response.headers_mut());
                return Box::pin(async move { Ok(response) });
            }
        };
        if let Some(caller) = request.extensions().get::<Caller>() {
            span.record("caller", caller.name());
        }
        request.extensions_mut().insert(id.clone());
        // The call itself may do work before it returns its future.
        let answer = span.in_scope(|| self.inner.call(request));
        let answered = async move {
            let answer = tokio::select! {
                answer = answer => answer,
                status = &mut means.revoked => {
                    means.revoked = Box::pin(std::future::pending());
                    Ok(status.into_http())
                }
            };
            let mut response = answer.inspect_err(|_| call.end(Code::Unknown as i32))?;
            // The question is answered, so its bytes are released.
            means.bytes.give_back();
            id.put_into(response.headers_mut());
            Ok(answer::watched(response, means, call).await)
        };
        Box::pin(answered.instrument(span))
    }
}

/// The resources of a call, until it has ended.
struct Means {
    /// Its place among the calls without a token of its connection, if it is one.
    _place: Option<Held>,
    /// Bytes of the question until it is answered, and then of the answer until it is read.
    bytes: Arc<Held>,
    connection: Option<Arc<OpenConnection>>,
    /// Ends with a status when the token of the call is revoked.
    revoked: Pin<Box<dyn Future<Output = Status> + Send>>,
}

impl Shared {
    /// Prepares a call for its service: adds the caller, and limits the body.
    fn let_in(
        &self,
        Admitted { caller, is_open }: Admitted,
        request: &mut Request<Body>,
    ) -> Result<Means, Status> {
        let extensions = request.extensions();
        let connection = permission::connection(extensions).map(|peer| peer.connection.clone());
        let peer = permission::peer(extensions).unwrap_or_default();
        let place = || self.open_calls.hold(vec![Limit::new(peer, OPEN_CALLS)], 1);
        let place = is_open.then(place).transpose()?;
        let key = caller.as_ref().map_or_else(|| permission::machine(extensions).address, Caller::label);
        let limits = vec![
            Limit::all_callers(self.held_bytes.saturating_mul(SHARES)),
            Limit::new(key, self.held_bytes),
        ];
        let bytes = Arc::new(self.bytes.hold(limits, 0)?);
        let held = (request.uri().path() != STREAMED).then(|| bytes.clone());
        let body = std::mem::take(request.body_mut());
        *request.body_mut() = question::watched(body, held);
        let Some(caller) = caller else {
            let revoked = Box::pin(std::future::pending());
            return Ok(Means { _place: place, bytes, connection, revoked });
        };
        if let Some(connection) = &connection {
            connection.admit(caller.hash(), self.gate.clone().revoked(caller.hash(), caller.role()));
        }
        request.extensions_mut().insert(caller.clone());
        let ended = self.gate.clone().revoked(caller.hash(), caller.role());
        let revoked = Box::pin(async move {
            ended.await;
            permission::revoked(&caller)
        });
        Ok(Means { _place: place, bytes, connection, revoked })
    }

    fn log_refused<B>(&self, request: &Request<B>, status: &Status) {
        if let Some(calls) = self.refused.count(self.clock.now()) {
            let peer = permission::peer(request.extensions());
            let (code, reason) = (status.code(), status.message());
            tracing::warn!(calls, peer, ?code, reason, "calls have been refused; this is the last of them");
        }
    }
}

#[cfg(test)]
mod tests;
