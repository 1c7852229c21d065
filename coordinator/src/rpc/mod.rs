//! The gRPC services: decode, one call, encode.

mod dictionaries;
mod farm_status;
mod fits;
mod leases;
mod status;

use std::sync::Arc;
use std::time::Duration;

use farm_proto::RequestLimits;
use farm_proto::wire::dictionaries_server::DictionariesServer;
use farm_proto::wire::farm_server::FarmServer;
use farm_proto::wire::fits_server::FitsServer;
use farm_proto::wire::leases_server::LeasesServer;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tonic::transport::Server;
use tonic::transport::server::TcpIncoming;

use crate::farm::Farm;

/// HTTP/2 pings find links that were cut without a word.
const KEEPALIVE: Duration = Duration::from_secs(20);

/// How long a stop waits for calls that are under way.
const GRACE: Duration = Duration::from_secs(3);

/// What every service needs.
#[derive(Debug, Clone)]
struct Context {
    farm: Arc<Farm>,
    shutdown: CancellationToken,
}

pub(crate) async fn serve(
    farm: Arc<Farm>,
    listener: TcpListener,
    shutdown: CancellationToken,
) -> Result<(), tonic::transport::Error> {
    let context = Context { farm, shutdown: shutdown.clone() };
    let limit = RequestLimits::MESSAGE_BYTES;
    let connections = TcpIncoming::from(listener).with_nodelay(Some(true));
    let server = Server::builder()
        .http2_keepalive_interval(Some(KEEPALIVE))
        .http2_keepalive_timeout(Some(KEEPALIVE))
        .add_service(DictionariesServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(LeasesServer::new(context.clone()).max_decoding_message_size(limit))
        .add_service(FitsServer::new(context.clone()).max_decoding_message_size(limit))
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
