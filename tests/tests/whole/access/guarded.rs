//! A server with the farm's authorisation and connection limits, real access files, and services that return their
//! caller.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::{Arc, Once};
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use farm_coordinator::Gate;
use farm_coordinator::authorisation::{AuthorisationLayer, Caller, RequestId};
use farm_coordinator::connections::{Connections, Incoming, Limits};
use farm_link::{ClientAccess, CoordinatorAccess, Link, Role, Target};
use http_body_util::BodyExt as _;
use http_body_util::Full;
use tokio::net::TcpListener;
use tokio_util::sync::{CancellationToken, DropGuard};
use tonic::body::Body;
use tonic::client::GrpcService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Server};
use tonic::{Code, Request, Response, Status};

/// Memory that the calls of one token may hold.
pub const HELD: usize = 4 << 20;

/// Interval of the server's pings.
pub const PING: Duration = Duration::from_millis(300);

/// Access control of a farm.
#[derive(Debug, Clone, Copy)]
pub enum Access {
    Open,
    Tokens,
}

pub struct GuardedServer {
    pub address: SocketAddr,
    pub connections: Connections,
    dir: tempfile::TempDir,
    _stop: DropGuard,
}

impl GuardedServer {
    pub async fn start(access: Access) -> Self {
        Self::start_with(access, Limits::new(64, None)).await
    }

    pub async fn start_with(access: Access, limits: Limits) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let coordinator = coordinator_access(access, &dir.path().join("access"), address.port());
        let gate = coordinator.clone().map_or(Gate::Everybody, Gate::File);
        let gate = AuthorisationLayer::new(gate, HELD, |_, _, _| ());
        let incoming = Incoming::new(listener, limits);
        let connections = incoming.connections();
        let mut server = Server::builder().http2_keepalive_interval(Some(PING)).layer(gate);
        if let Some(coordinator) = coordinator {
            server = server.tls_config(coordinator.server_tls()).unwrap();
        }
        let stop = CancellationToken::new();
        let router = server
            .add_service(tonic_health::server::health_reporter().1.max_decoding_message_size(4 << 10))
            .add_service(WhoCalled::<0>)
            .add_service(WhoCalled::<1>)
            .add_service(WhoCalled::<2>);
        tokio::spawn(
            router.serve_with_incoming_shutdown(incoming.into_stream(), stop.clone().cancelled_owned()),
        );
        Self { address, connections, dir, _stop: stop.drop_guard() }
    }

    pub fn url(&self) -> String {
        format!("https://localhost:{}", self.address.port())
    }

    pub fn file(&self, role: Role) -> PathBuf {
        self.dir.path().join("access").join(format!("{role}.toml"))
    }

    pub fn target(&self, role: Role) -> Target {
        Target::new(Some(&ClientAccess::read(&self.file(role)).unwrap()), None).unwrap()
    }

    pub async fn link(&self, role: Role) -> Link {
        self.target(role).connect().await.unwrap()
    }

    /// The text of an access file.
    pub fn text(&self, role: Role) -> String {
        std::fs::read_to_string(self.file(role)).unwrap()
    }

    /// The target of an access file with other content.
    pub fn target_of_text(&self, text: &str) -> Target {
        let file = tempfile::NamedTempFile::new_in(self.dir.path()).unwrap();
        std::fs::write(file.path(), text).unwrap();
        Target::new(Some(&ClientAccess::read(file.path()).unwrap()), None).unwrap()
    }

    pub async fn tls_channel_without_token(&self) -> Channel {
        let text = self.text(Role::Client);
        let authority = &text[text.find("-----BEGIN").unwrap()..];
        let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(authority));
        Endpoint::from_shared(self.url()).unwrap().tls_config(tls).unwrap().connect().await.unwrap()
    }

    pub async fn wait_for_open(&self, connections: usize) {
        wait(|| self.connections.open() == connections).await;
    }
}

fn coordinator_access(access: Access, dir: &Path, port: u16) -> Option<Arc<CoordinatorAccess>> {
    if matches!(access, Access::Open) {
        return None;
    }
    let hosts = ["localhost", "farm.example.org"].map(str::to_owned);
    let now_unix_s = farm_coordinator::clock::Clock::unix_ms() as i64 / 1000;
    let created = farmctl::access_files::create(dir, &hosts, port, false, now_unix_s).unwrap();
    Some(Arc::new(CoordinatorAccess::read(&created.coordinator).unwrap()))
}

async fn wait(until: impl Fn() -> bool) {
    let waited = async {
        while !until() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(farm_tests::process::SOON, waited).await.expect("it happens in time");
}

pub type Answered = Result<Response<()>, Status>;

pub async fn call<S: GrpcService<Body, ResponseBody = Body> + Clone>(
    service: &S,
    path: &'static str,
) -> Answered {
    call_with(service, path, Request::new(())).await
}

/// A unary call of messages without content.
pub async fn call_with<S: GrpcService<Body, ResponseBody = Body> + Clone>(
    service: &S,
    path: &'static str,
    request: Request<()>,
) -> Answered {
    let mut client = tonic::client::Grpc::new(service.clone());
    client.ready().await.map_err(|error| Status::unavailable(format!("{:?}", error.into())))?;
    let codec = tonic_prost::ProstCodec::<(), ()>::default();
    client.unary(request, http::uri::PathAndQuery::from_static(path), codec).await
}

pub async fn health<S: GrpcService<Body, ResponseBody = Body> + Clone>(service: S) -> Answered {
    call(&service, "/grpc.health.v1.Health/Check").await
}

/// The log of this thread.
pub struct Log(tempfile::NamedTempFile);

impl Log {
    pub fn start() -> (Self, tracing::subscriber::DefaultGuard) {
        // If another test reached a place of the log first, without a subscriber, it would be off for this one.
        static OTHERS: Once = Once::new();
        OTHERS.call_once(|| {
            let all = tracing_subscriber::fmt().with_max_level(tracing::Level::TRACE);
            let _ = tracing::subscriber::set_global_default(all.with_writer(std::io::sink).finish());
        });
        let file = tempfile::NamedTempFile::new().unwrap();
        let writer = Arc::new(file.reopen().unwrap());
        let plain = tracing_subscriber::fmt().with_max_level(tracing::Level::TRACE).with_ansi(false);
        (Self(file), tracing::subscriber::set_default(plain.with_writer(writer).finish()))
    }

    pub fn text(&self) -> String {
        std::fs::read_to_string(self.0.path()).unwrap()
    }
}

const SERVICES: [&str; 3] = ["farm.v1.Leases", "farm.v1.Fits", "farm.v1.Admin"];

/// Answers every method with the name of its caller. `Slow` never answers.
#[derive(Debug, Clone)]
struct WhoCalled<const SERVICE: usize>;

impl<const SERVICE: usize> tonic::server::NamedService for WhoCalled<SERVICE> {
    const NAME: &'static str = SERVICES[SERVICE];
}

impl<const SERVICE: usize> tower::Service<http::Request<Body>> for WhoCalled<SERVICE> {
    type Response = http::Response<Body>;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<http::Response<Body>, Infallible>> + Send>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, request: http::Request<Body>) -> Self::Future {
        Box::pin(async move {
            if request.uri().path().ends_with("/Slow") {
                std::future::pending::<()>().await;
            }
            tracing::info!("handling");
            assert!(request.extensions().get::<RequestId>().is_some());
            let caller = request.extensions().get::<Caller>();
            let name = caller.map_or("anonymous".to_owned(), |c| format!("{} {}", c.name(), c.role()));
            let trailers = http::HeaderMap::from_iter([(Status::GRPC_STATUS, (Code::Ok as i32).into())]);
            let message = Full::new(Bytes::from_static(&[0; 5]));
            let body = message.with_trailers(std::future::ready(Some(Ok(trailers))));
            let answer =
                http::Response::builder().header("content-type", "application/grpc").header("x-caller", name);
            Ok(answer.body(Body::new(body)).unwrap())
        })
    }
}
