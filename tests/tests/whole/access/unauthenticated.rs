//! Limits of peers without a token: few and small calls, few connections, for a short time.

use std::time::Duration;

use farm_coordinator::connections::{Limits, UnauthenticatedLimits};
use farm_link::Role;
use tokio::time::timeout;
use tonic::Code;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use super::guarded::{Access, GuardedServer, call};
use super::{FITS, LEASES};

fn request(bytes: usize) -> HealthCheckRequest {
    HealthCheckRequest { service: "x".repeat(bytes) }
}

async fn server(patience: Duration) -> GuardedServer {
    let limits = Limits::new(64, Some(UnauthenticatedLimits { connections: 3, patience }));
    GuardedServer::start_with(Access::Tokens, limits).await
}

/// The guards whose limits the unit tests of the coordinator prove are in place: few and small calls without a token.
#[tokio::test]
async fn calls_without_a_token_are_limited() {
    let farm = server(Duration::from_mins(1)).await;
    let mut client = HealthClient::new(farm.tls_channel_without_token().await);
    assert_eq!(client.check(request(4000)).await.unwrap_err().code(), Code::NotFound, "no such service");
    assert_eq!(client.check(request(5000)).await.unwrap_err().code(), Code::OutOfRange);
    let mut watches = Vec::new();
    let refused = loop {
        match client.watch(request(0)).await {
            Ok(watch) => watches.push(watch),
            Err(status) => break status,
        }
        assert!(watches.len() < 100);
    };
    assert_eq!((watches.len(), refused.code()), (8, Code::ResourceExhausted), "{refused}");
    let authenticated = farm.link(Role::Client).await;
    let mut calls = tokio::task::JoinSet::new();
    for _ in 0..20 {
        let authenticated = authenticated.clone();
        calls.spawn(async move { call(&authenticated, "/farm.v1.Fits/Slow").await.map(drop) });
    }
    let ended = timeout(Duration::from_millis(300), calls.join_next()).await;
    assert!(ended.is_err(), "no call with a token is refused: {ended:?}");
}

/// Connections without a token end, and do not lock others out.
#[tokio::test]
async fn unauthenticated_connections_end() {
    let farm = server(Duration::from_secs(2)).await;
    let authenticated = farm.link(Role::Client).await;
    call(&authenticated, FITS).await.unwrap();
    let mut channels = Vec::new();
    for _ in 0..3 {
        channels.push(farm.tls_channel_without_token().await);
    }
    // All connections of this address are in use: the oldest unauthenticated one is evicted, authenticated ones stay.
    assert_eq!(farm.connections.open(), 4);
    call(&farm.link(Role::Worker).await, LEASES).await.unwrap();
    assert_eq!(farm.connections.refused(), 0);
    farm.wait_for_open(1).await;
    call(&authenticated, FITS).await.unwrap();
}
