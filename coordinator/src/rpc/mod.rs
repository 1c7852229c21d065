//! The gRPC services: decode, one call, encode.

mod admin;
mod dictionaries;
mod farm_status;
mod fits;
mod leases;
mod limits;
mod page;
mod results;
mod status;

use std::sync::Arc;
use std::time::Duration;

use farm_proto::wire::admin_server::AdminServer;
use farm_proto::wire::dictionaries_server::DictionariesServer;
use farm_proto::wire::farm_server::FarmServer;
use farm_proto::wire::fits_server::FitsServer;
use farm_proto::wire::leases_server::LeasesServer;
use farm_proto::{RequestLimits, wire};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tonic::transport::Server;

use crate::config::Config;
use crate::farm::Farm;
use crate::gate::GateLayer;
use crate::incoming::{self, Incoming};
use limits::Limits;

/// HTTP/2 pings find links that were cut without a word.
const KEEPALIVE: Duration = Duration::from_secs(20);

/// How long a stop waits for calls that are under way.
const GRACE: Duration = Duration::from_secs(3);

/// Calls under way on one connection.
const STREAMS: u32 = 256;

/// What every service needs.
#[derive(Debug, Clone)]
struct Context {
    farm: Arc<Farm>,
    shutdown: CancellationToken,
    limits: Limits,
}

pub(crate) async fn serve(
    farm: Arc<Farm>,
    config: &Config,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), tonic::transport::Error> {
    let context = Context { farm, shutdown: shutdown.clone(), limits: Limits::default() };
    let limit = RequestLimits::MESSAGE_BYTES;
    let connections = Incoming::new(listener, incoming::Limits::new(config.max_connections));
    let (health, health_service) = tonic_health::server::health_reporter();
    health.set_serving::<DictionariesServer<Context>>().await;
    health.set_serving::<LeasesServer<Context>>().await;
    health.set_serving::<FitsServer<Context>>().await;
    health.set_serving::<FarmServer<Context>>().await;
    health.set_serving::<AdminServer<Context>>().await;
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()
        .expect("the descriptors were made by the compiler");
    let mut server = Server::builder()
        .http2_keepalive_interval(Some(KEEPALIVE))
        .http2_keepalive_timeout(Some(KEEPALIVE))
        .max_concurrent_streams(STREAMS)
        .layer(GateLayer::new(config.access.clone(), |_, _, _| {}));
    if let Some(access) = &config.access {
        server = server.tls_config(access.server_tls())?;
    }
    let server = server
        .add_service(health_service)
        .add_service(reflection)
        .add_service(DictionariesServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(LeasesServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(FitsServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(AdminServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(FarmServer::new(context).max_decoding_message_size(limit))
        .serve_with_incoming_shutdown(connections, shutdown.clone().cancelled_owned());
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
