//! Implements the gRPC services: each method decodes, makes one call, and encodes.

mod admin;
mod dictionaries;
mod farm_status;
mod fits;
mod leases;
mod limits;
mod measurements;
mod outgoing;
mod page;
mod status;
mod text;
mod work;

use std::sync::Arc;
use std::time::Duration;

use farm_proto::wire::admin_server::AdminServer;
use farm_proto::wire::dictionaries_server::DictionariesServer;
use farm_proto::wire::farm_server::FarmServer;
use farm_proto::wire::fits_server::FitsServer;
use farm_proto::wire::leases_server::LeasesServer;
use farm_proto::wire::measurements_server::MeasurementsServer;
use farm_proto::{RequestLimits, wire};
use tokio_util::sync::CancellationToken;
use tonic::Status;
use tonic::service::Routes;
use tonic::transport::Server;

use self::outgoing::{Outgoing, Source, outgoing};
use crate::actor::Actor;
use crate::authorisation::AuthorisationLayer;
use crate::config::Config;
use crate::connections::{self, Connections, Incoming, UnauthenticatedLimits};
use crate::farm::{Farm, MESSAGE_BYTES};
use crate::gate::{Gate, Listener};
use crate::metrics::Metrics;
use limits::Limits;

/// Interval of HTTP/2 pings, which detect links that were cut silently, and keep links open that would be cut when idle.
const PING: Duration = Duration::from_secs(10);
/// Time limit for the answer to a ping.
const PONG: Duration = Duration::from_secs(20);

/// Interval at which the number of refused connections is read.
const LOOK: Duration = Duration::from_secs(1);

/// Longest time that a stop waits for calls that are under way.
const GRACE: Duration = Duration::from_secs(3);

/// Largest number of calls under way on one connection.
const STREAMS: u32 = 256;

/// Smallest budget for the questions and unread answers of one token: several of the largest messages.
const HELD_BYTES: usize = 128 << 20;

/// Largest message of a call that needs no token: the names of a service or a few.
const OPEN_BYTES: usize = 4 << 10;

/// Largest HTTP/2 frame: results of some 100 kB are read in few pieces.
const FRAME_BYTES: u32 = 64 << 10;

/// State that every service needs.
#[derive(Debug, Clone)]
struct Context {
    farm: Arc<Farm>,
    shutdown: CancellationToken,
    limits: Limits,
    /// Most pixels of one question about measurements.
    question_pixels: usize,
    /// Largest answer to one, in bytes: half of the budget of one token's calls.
    answer_bytes: usize,
}

impl Context {
    /// Streams the items of a source to a caller.
    fn stream<S: Source, T: 'static>(
        &self,
        caller: &Actor,
        source: S,
        encode: impl Fn(S::Item) -> T + Send + 'static,
    ) -> Result<Outgoing<T>, Status> {
        let place = self.limits.stream(caller.shares_as())?;
        Ok(outgoing(source, encode, self.shutdown.clone(), place))
    }
}

pub(crate) async fn serve(
    farm: Arc<Farm>,
    config: &Config,
    gate: Gate,
    listener: Listener,
    shutdown: CancellationToken,
) -> Result<(), tonic::transport::Error> {
    let metrics = farm.metrics().clone();
    let question_limit = config.question_pixels.saturating_mul(RequestLimits::PIXEL_BYTES);
    let held = HELD_BYTES.max(question_limit.saturating_mul(4));
    let context = Context {
        farm,
        shutdown: shutdown.clone(),
        limits: Limits::default(),
        question_pixels: config.question_pixels,
        answer_bytes: held / 2,
    };
    let unauthenticated = gate.has_unauthenticated_peers().then(UnauthenticatedLimits::default);
    let incoming = Incoming::new(listener, connections::Limits::new(config.max_connections, unauthenticated));
    tokio::spawn(count_refused(incoming.connections(), metrics.clone(), shutdown.clone()));
    let mut server = Server::builder()
        .http2_keepalive_interval(Some(PING))
        .http2_keepalive_timeout(Some(PONG))
        .max_concurrent_streams(STREAMS)
        .max_frame_size(FRAME_BYTES)
        .layer(AuthorisationLayer::new(gate.clone(), held, move |method, code, took| {
            metrics.rpc(method, code, took);
        }));
    if let Some(tls) = gate.tls() {
        server = server.tls_config(tls)?;
    }
    let server = server
        .add_routes(services(context, question_limit).await)
        .serve_with_incoming_shutdown(incoming.into_stream(), shutdown.clone().cancelled_owned());
    tokio::select! {
        served = server => served,
        () = async {
            shutdown.cancelled().await;
            tokio::time::sleep(GRACE).await;
        } => {
            tracing::warn!("clients did not let go in time: their connections are cut");
            Ok(())
        }
    }
}

/// The services of `farm.v1`, with health and reflection.
async fn services(context: Context, question_limit: usize) -> Routes {
    let (health, health_service) = tonic_health::server::health_reporter();
    let health_service = health_service.max_decoding_message_size(OPEN_BYTES);
    health.set_serving::<DictionariesServer<Context>>().await;
    health.set_serving::<LeasesServer<Context>>().await;
    health.set_serving::<FitsServer<Context>>().await;
    health.set_serving::<FarmServer<Context>>().await;
    health.set_serving::<MeasurementsServer<Context>>().await;
    health.set_serving::<AdminServer<Context>>().await;
    let descriptors = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    // Older tools use the older version.
    let reflection = descriptors().build_v1().expect("the descriptors were made by the compiler");
    let older_reflection = descriptors().build_v1alpha().expect("the descriptors were made by the compiler");
    let limit = RequestLimits::MESSAGE_BYTES;
    Routes::new(health_service)
        .add_service(reflection.max_decoding_message_size(OPEN_BYTES))
        .add_service(older_reflection.max_decoding_message_size(OPEN_BYTES))
        .add_service(DictionariesServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(LeasesServer::new(context.clone()).max_decoding_message_size(MESSAGE_BYTES))
        .add_service(FitsServer::new(context.clone()).max_decoding_message_size(question_limit))
        .add_service(MeasurementsServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(AdminServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(FarmServer::new(context).max_decoding_message_size(limit))
}

/// Adds the number of refused connections to the metrics.
async fn count_refused(connections: Connections, metrics: Metrics, shutdown: CancellationToken) {
    let mut counted = 0;
    while !shutdown.is_cancelled() {
        let refused = connections.refused();
        (counted..refused).for_each(|_| metrics.connection_refused());
        counted = refused;
        tokio::select! {
            () = shutdown.cancelled() => {}
            () = tokio::time::sleep(LOOK) => {}
        }
    }
}
