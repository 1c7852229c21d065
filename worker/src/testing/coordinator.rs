//! A coordinator that records all calls and gives scripted answers; without a script it accepts everything.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use farm_link::Link;
use farm_proto::lease::{Lease, LeaseKey};
use farm_proto::wire::complete_request::Content;
use farm_proto::wire::leases_server::{Leases, LeasesServer};
use farm_proto::wire::*;
use hyper_util::rt::TokioIo;
use tokio::sync::watch;
use tokio_stream::wrappers::UnboundedReceiverStream;
use tonic::transport::{Endpoint, Server};
use tonic::{Request, Response, Status, Streaming};

use super::network::Network;

/// Time limit of a test for something to happen.
const PATIENCE: Duration = Duration::from_mins(1);

/// A result as it was received.
#[derive(Debug, Clone)]
pub(crate) struct DeliveredResult {
    pub key: LeaseKey,
    pub identity: Vec<u8>,
    pub bytes: usize,
}

/// The methods, their calls as they were received, and a function for each that picks its calls.
macro_rules! methods {
    ($($method:ident $pick:ident ($request:ty)),+ $(,)?) => {
        #[derive(Debug, Clone)]
        pub(crate) enum Call {
            $($method($request)),+
        }

        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub(crate) enum Method {
            $($method),+
        }

        impl Call {
            fn method(&self) -> Method {
                match self {
                    $(Self::$method(_) => Method::$method),+
                }
            }

            $(pub(crate) fn $pick(&self) -> Option<$request> {
                if let Self::$method(request) = self { Some(request.clone()) } else { None }
            })+
        }
    };
}

methods! {
    Register register(RegisterRequest),
    Acquire acquire(AcquireRequest),
    Renew renew(RenewRequest),
    Complete results(Vec<DeliveredResult>),
    HandBack hand_back(HandBackRequest),
    Fail fail(FailRequest),
}

impl Call {
    /// The jobs whose results are delivered.
    pub(crate) fn complete(&self) -> Option<Vec<u32>> {
        Some(self.results()?.iter().map(|result| result.key.job).collect())
    }
}

/// A scripted answer, instead of the normal one.
#[derive(Debug, Clone)]
pub(crate) enum Answer {
    Error(Status),
    /// The call is received, but its connection is cut before the answer.
    Lost,
    /// Outcomes of the results, one by one.
    Outcomes(Vec<CompletionKind>),
    /// No answer at all.
    Never,
}

#[derive(Debug, Clone)]
pub(crate) struct Coordinator(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    network: Network,
    state: Mutex<State>,
    /// Counts changes of the state.
    changes: watch::Sender<u64>,
}

#[derive(Debug, Default)]
struct State {
    calls: Vec<Call>,
    answers: HashMap<Method, VecDeque<Answer>>,
    offered: VecDeque<Lease>,
    lost: Vec<LeaseKey>,
    drain: bool,
    lease: Duration,
    registrations: usize,
    /// Token of the registered worker.
    registered: Option<String>,
}

impl Coordinator {
    pub(crate) fn start() -> Self {
        let (network, incoming) = Network::new();
        let state = State { lease: Duration::from_secs(30), ..State::default() };
        let shared = Shared { network, state: Mutex::new(state), changes: watch::Sender::new(0) };
        let coordinator = Self(Arc::new(shared));
        let server = Server::builder().add_service(LeasesServer::new(coordinator.clone()));
        tokio::spawn(server.serve_with_incoming(UnboundedReceiverStream::new(incoming)));
        coordinator
    }

    pub(crate) fn link(&self) -> Link {
        let shared = self.0.clone();
        let connector = tower::service_fn(move |_| {
            let connection = shared.network.connect().map(TokioIo::new);
            async { connection }
        });
        Endpoint::from_static("http://test").connect_with_connector_lazy(connector).into()
    }

    /// Scripts the answer of the next call of a method; several answers are given in this order.
    pub(crate) fn answer(&self, method: Method, answer: Answer) {
        self.change(|state| state.answers.entry(method).or_default().push_back(answer));
    }

    pub(crate) fn offer(&self, leases: impl IntoIterator<Item = Lease>) {
        self.change(|state| state.offered.extend(leases));
    }

    /// Reports a lease as lost at the next renewal.
    pub(crate) fn lose(&self, key: LeaseKey) {
        self.change(|state| state.lost.push(key));
    }

    pub(crate) fn drain(&self) {
        self.change(|state| state.drain = true);
    }

    /// As after a restart: the worker is unknown, and new leases have this length.
    pub(crate) fn restart(&self, lease: Duration) {
        self.set_lease(lease);
        self.change(|state| state.registered = None);
    }

    /// Sets the length of the leases of later registrations.
    pub(crate) fn set_lease(&self, lease: Duration) {
        self.change(|state| state.lease = lease);
    }

    pub(crate) fn set_down(&self, down: bool) {
        self.0.network.set_down(down);
    }

    /// The values that `pick` returns for all calls so far.
    pub(crate) fn calls<T>(&self, pick: impl FnMut(&Call) -> Option<T>) -> Vec<T> {
        self.state().calls.iter().filter_map(pick).collect()
    }

    /// Waits until `pick` returns `count` values, and returns them.
    pub(crate) async fn wait_for<T>(&self, count: usize, mut pick: impl FnMut(&Call) -> Option<T>) -> Vec<T> {
        let mut changes = self.0.changes.subscribe();
        let enough = async {
            loop {
                let calls = self.calls(&mut pick);
                if calls.len() >= count {
                    return calls;
                }
                changes.changed().await.unwrap();
            }
        };
        let ended = tokio::time::timeout(PATIENCE, enough).await;
        ended.unwrap_or_else(|_| panic!("{count} such calls were expected: {:#?}", self.state().calls))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap()
    }

    fn change<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let changed = change(&mut self.state());
        self.0.changes.send_modify(|count| *count += 1);
        changed
    }

    /// Records a call and returns its scripted answer; None is the normal one.
    async fn receive(&self, call: Call) -> Result<Option<Vec<CompletionKind>>, Status> {
        let answer = self.change(|state| {
            let answers = state.answers.get_mut(&call.method());
            state.calls.push(call);
            answers?.pop_front()
        });
        match answer {
            None => Ok(None),
            Some(Answer::Outcomes(outcomes)) => Ok(Some(outcomes)),
            Some(Answer::Error(status)) => Err(status),
            Some(Answer::Lost) => {
                self.0.network.cut();
                std::future::pending().await
            }
            Some(Answer::Never) => std::future::pending().await,
        }
    }

    fn check(&self, worker_token: &str) -> Result<(), Status> {
        if self.state().registered.as_deref() == Some(worker_token) {
            return Ok(());
        }
        Err(Status::aborted(format!("worker {worker_token} is not registered: register")))
    }

    /// Offered leases, or the request that the worker leave.
    fn grant(&self, most: u32) -> Option<AcquireResponse> {
        let mut state = self.state();
        let count = state.offered.len().min(most as usize);
        let leases: Vec<_> = state.offered.drain(..count).map(Into::into).collect();
        (state.drain || !leases.is_empty()).then_some(AcquireResponse { leases, drain: state.drain })
    }
}

type Answered<T> = Result<Response<T>, Status>;

#[tonic::async_trait]
impl Leases for Coordinator {
    async fn register(&self, request: Request<RegisterRequest>) -> Answered<RegisterResponse> {
        self.receive(Call::Register(request.into_inner())).await?;
        Ok(Response::new(self.change(|state| {
            state.registrations += 1;
            let worker_token = format!("worker-{}", state.registrations);
            state.registered = Some(worker_token.clone());
            RegisterResponse { worker_token, lease_ms: state.lease.as_millis() as u64 }
        })))
    }

    async fn acquire(&self, request: Request<AcquireRequest>) -> Answered<AcquireResponse> {
        let request = request.into_inner();
        self.receive(Call::Acquire(request.clone())).await?;
        self.check(&request.worker_token)?;
        let mut changes = self.0.changes.subscribe();
        let wait = tokio::time::sleep(Duration::from_millis(request.wait_ms));
        tokio::pin!(wait);
        loop {
            changes.mark_unchanged();
            if let Some(granted) = self.grant(request.max_leases) {
                return Ok(Response::new(granted));
            }
            tokio::select! {
                () = &mut wait => return Ok(Response::new(AcquireResponse::default())),
                _ = changes.changed() => self.check(&request.worker_token)?,
            }
        }
    }

    async fn renew(&self, request: Request<RenewRequest>) -> Answered<RenewResponse> {
        let request = request.into_inner();
        self.receive(Call::Renew(request.clone())).await?;
        self.check(&request.worker_token)?;
        let named: Vec<LeaseKey> =
            request.leases.into_iter().filter_map(|lease| lease.key).map(Into::into).collect();
        let mut state = self.state();
        let lost = state.lost.extract_if(.., |key| named.contains(key)).map(Into::into).collect();
        Ok(Response::new(RenewResponse { lost, drain: state.drain }))
    }

    async fn complete(&self, request: Request<Streaming<CompleteRequest>>) -> Answered<CompleteResponse> {
        let mut messages = request.into_inner();
        let mut worker_token = String::new();
        let mut results: Vec<DeliveredResult> = Vec::new();
        while let Some(message) = messages.message().await? {
            match message.content.expect("no message is empty") {
                Content::Header(header) => {
                    worker_token = header.worker_token;
                    let key = header.key.expect("a header has a key").into();
                    results.push(DeliveredResult { key, identity: header.identity, bytes: 0 });
                }
                Content::Records(piece) | Content::Sums(piece) => {
                    results.last_mut().expect("a header comes first").bytes += piece.len();
                }
            }
        }
        let count = results.len();
        let outcomes = self.receive(Call::Complete(results)).await?;
        self.check(&worker_token)?;
        let outcomes = outcomes.unwrap_or_else(|| vec![CompletionKind::Stored; count]);
        let outcome = |kind: CompletionKind| CompletionOutcome { kind: kind.into(), message: String::new() };
        Ok(Response::new(CompleteResponse { outcomes: outcomes.into_iter().map(outcome).collect() }))
    }

    async fn hand_back(&self, request: Request<HandBackRequest>) -> Answered<HandBackResponse> {
        self.receive(Call::HandBack(request.into_inner())).await?;
        Ok(Response::new(HandBackResponse {}))
    }

    async fn fail(&self, request: Request<FailRequest>) -> Answered<FailResponse> {
        let request = request.into_inner();
        self.receive(Call::Fail(request.clone())).await?;
        self.check(&request.worker_token)?;
        Ok(Response::new(FailResponse {}))
    }
}
