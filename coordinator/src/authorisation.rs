//! Wraps every call with a request id, authorisation, and an observer.
//!
//! [`AuthorisationLayer`] surrounds all services (`Server::builder().layer(…)`), so that a service added later is
//! guarded by default: methods without a rule are for admins.

mod answer;
mod budget;
mod callers_body;
mod message;
mod open_call;
mod permission;
mod report;
mod request_id;

use std::fmt;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use http::header::AUTHORIZATION;
use http::{Request, Response};
use tokio::sync::OwnedSemaphorePermit;
use tonic::Status;
use tonic::body::Body;
use tower::{Layer, Service};
use tracing::Instrument as _;

use crate::clock::Clock;
use crate::connections::Admission;
use crate::gate::Gate;
use crate::throttle::Throttle;

pub use permission::Caller;
pub(crate) use permission::{actor, machine};
pub use report::ObservedBody;
pub use request_id::RequestId;

use budget::{Account, Budget};
use permission::Admitted;
use report::Report;

/// The method name with which calls are observed that no service has answered: callers may choose any path.
pub const OTHER_METHOD: &str = "other";

/// The method whose calls stream many messages: each is passed on before the next.
const STREAMED: &str = "/farm.v1.Leases/Complete";

/// Interval at which a waiting call checks whether its token is accepted, and whether it is overdue.
const LOOK: Duration = Duration::from_secs(1);

/// Refused calls are logged at most this often.
const TELL_REFUSED: Duration = Duration::from_secs(10);

/// Makes services [`Authorised`]: calls need the tokens of the gate, if it has any.
#[derive(Clone)]
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
    budget: Arc<Budget>,
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
        let (observer, budget) = (Box::new(observer), Arc::new(Budget::of(held_bytes)));
        let (clock, refused) = (Clock::start(), Throttle::new(TELL_REFUSED));
        let shared = Shared { gate, observer, clock, refused, budget };
        Self { shared: Arc::new(shared) }
    }
}

impl fmt::Debug for AuthorisationLayer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("AuthorisationLayer").field("gate", &self.shared.gate).finish_non_exhaustive()
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
#[derive(Clone)]
pub struct Authorised<S> {
    inner: S,
    shared: Arc<Shared>,
}

impl<S: fmt::Debug> fmt::Debug for Authorised<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Authorised").field("inner", &self.inner).finish_non_exhaustive()
    }
}

impl<S> Service<Request<Body>> for Authorised<S>
where
    S: Service<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
{
    type Response = Response<ObservedBody>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(cx)
    }

    fn call(&mut self, mut request: Request<Body>) -> Self::Future {
        let method = request.uri().path().to_owned();
        let id = RequestId::of(request.headers());
        let span = tracing::info_span!("call", %method, request_id = %id, caller = tracing::field::Empty);
        let admitted = permission::admit(&self.shared.gate, &request)
            .and_then(|admitted| let_in(admitted, &self.shared, &mut request));
        let caller = match &admitted {
            Ok(_) => request.extensions().get::<Caller>().cloned(),
            Err(_) => None,
        };
        let connection = permission::connection(request.extensions()).map(|peer| peer.admission.clone());
        let report = Report::start(self.shared.clone(), method, span.clone(), caller, connection);
        // Handlers do not need the token, and cannot log what they do not receive.
        request.headers_mut().remove(AUTHORIZATION);
        match admitted {
            Ok(means) => {
                if let Some(caller) = request.extensions().get::<Caller>() {
                    span.record("caller", caller.name());
                }
                request.extensions_mut().insert(id.clone());
                // The call itself may do work before it returns its future.
                let answer = span.in_scope(|| self.inner.call(request));
                let answered = async move {
                    let response = report.pass(answer.await, &id, means)?;
                    let (head, body) = response.into_parts();
                    Ok(Response::from_parts(head, body.fetched().await))
                };
                Box::pin(answered.instrument(span))
            }
            Err(status) => {
                span.in_scope(|| self.shared.log_refused(&request, &status));
                let response = report.refuse(status, &id);
                Box::pin(async move { Ok(response) })
            }
        }
    }
}

/// The resources of a call, until it has ended.
struct Means {
    /// Its place among the open calls of its connection, if it is an open call.
    _place: Option<OwnedSemaphorePermit>,
    account: Account,
}

/// Prepares a call for its service: adds the caller, and limits the body.
fn let_in(admitted: Admitted, shared: &Shared, request: &mut Request<Body>) -> Result<Means, Status> {
    let connection = permission::connection(request.extensions()).map(|peer| peer.admission.clone());
    if let (Some(connection), Admitted::Caller(_) | Admitted::Anybody | Admitted::Open { known: true }) =
        (&connection, &admitted)
    {
        connection.admit();
    }
    let caller = match admitted {
        Admitted::Caller(caller) => Some(caller),
        Admitted::Anybody => None,
        Admitted::Open { .. } => return open(connection, shared, request),
    };
    let name =
        caller.as_ref().map_or_else(|| permission::machine(request.extensions()).address, Caller::label);
    let account = Account::new(shared.budget.clone(), name);
    let streamed = request.uri().path() == STREAMED;
    let gate_and_caller = caller.clone().map(|caller| (shared.gate.clone(), caller));
    if let (Some(connection), Some((gate, caller))) = (connection, gate_and_caller.clone()) {
        connection.stays_while(caller.hash(), move || permission::is_let_in_still(&gate, &caller));
    }
    let body = std::mem::take(request.body_mut());
    *request.body_mut() = callers_body::watched(body, gate_and_caller, account.clone(), streamed);
    if let Some(caller) = caller {
        request.extensions_mut().insert(caller);
    }
    Ok(Means { _place: None, account })
}

/// Prepares a call that needs no token.
fn open(
    connection: Option<Admission>,
    shared: &Shared,
    request: &mut Request<Body>,
) -> Result<Means, Status> {
    let account = Account::new(shared.budget.clone(), permission::machine(request.extensions()).address);
    let body = std::mem::take(request.body_mut());
    *request.body_mut() = open_call::limited(body);
    let Some(connection) = connection else { return Ok(Means { _place: None, account }) };
    let place = connection.open_call().ok_or_else(|| {
        Status::resource_exhausted("too many calls without a token are under way on this connection")
    })?;
    Ok(Means { _place: Some(place), account })
}

impl Shared {
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
