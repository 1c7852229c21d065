//! Limits of peers without a token: few and small calls, for a short time.

use std::time::Duration;

use farm_coordinator::connections::{Limits, UnauthenticatedLimits};
use farm_link::Role;
use tokio::time::{Instant, sleep, timeout};
use tonic::Code;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use super::guarded::{Access, GuardedServer, call, health};
use super::{FITS, LEASES, SOON};

const SLOW: &str = "/farm.v1.Fits/Slow";

fn limits(patience: Duration) -> Limits {
    Limits::new(64, Some(UnauthenticatedLimits { connections: 3, patience }))
}

fn request(bytes: usize) -> HealthCheckRequest {
    HealthCheckRequest { service: "x".repeat(bytes) }
}

#[tokio::test]
async fn unauthenticated_requests_are_small() {
    let farm = GuardedServer::start_with(Access::Tokens, limits(SOON)).await;
    let channel = farm.tls_channel_without_token().await;
    let mut client = HealthClient::new(channel.clone());
    assert_eq!(
        client.check(request(4000)).await.unwrap_err().code(),
        Code::NotFound,
        "there is no such service"
    );
    let status = client.check(request(5000)).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
    health(channel).await.unwrap();
}

/// An incomplete request is cancelled, since it holds memory for a peer without a token.
#[tokio::test]
async fn unauthenticated_requests_that_never_end_are_cancelled() {
    let farm = GuardedServer::start_with(Access::Tokens, limits(Duration::from_mins(1))).await;
    let channel = farm.tls_channel_without_token().await;
    let begun = Instant::now();
    let mut grpc = tonic::client::Grpc::new(channel.clone());
    grpc.ready().await.unwrap();
    let path = http::uri::PathAndQuery::from_static("/grpc.health.v1.Health/Check");
    let codec =
        tonic_prost::ProstCodec::<HealthCheckRequest, tonic_health::pb::HealthCheckResponse>::default();
    let never = tonic::Request::new(tokio_stream::pending());
    let ended = timeout(Duration::from_secs(20), grpc.streaming(never, path, codec)).await;
    let status = match ended.expect("it is cancelled") {
        Err(status) => status,
        Ok(answer) => answer.into_inner().message().await.unwrap_err(),
    };
    assert_eq!(status.code(), Code::DeadlineExceeded, "{status}");
    assert!(begun.elapsed() >= Duration::from_secs(10), "{:?}", begun.elapsed());
    health(channel).await.unwrap();
}

/// The number of concurrent calls is bounded only without a token.
#[tokio::test]
async fn calls_are_bounded_only_without_a_token() {
    let farm = GuardedServer::start_with(Access::Tokens, limits(SOON)).await;
    let mut client = HealthClient::new(farm.tls_channel_without_token().await);
    let mut watches = Vec::new();
    let refused = loop {
        match client.watch(request(0)).await {
            Ok(watch) => watches.push(watch),
            Err(status) => break status,
        }
        assert!(watches.len() < 100);
    };
    assert_eq!((watches.len(), refused.code()), (8, Code::ResourceExhausted), "{refused}");
    drop(watches);
    let authenticated = farm.target(Role::Client).connect().await.unwrap();
    call(&authenticated, FITS).await.unwrap();
    let mut calls = tokio::task::JoinSet::new();
    for _ in 0..20 {
        let authenticated = authenticated.clone();
        calls.spawn(async move { call(&authenticated, SLOW).await.map(drop) });
    }
    let ended = timeout(Duration::from_millis(300), calls.join_next()).await;
    assert!(ended.is_err(), "none is refused: {ended:?}");
}

/// Connections without a token end, and do not lock others out.
#[tokio::test]
async fn unauthenticated_connections_end() {
    let farm = GuardedServer::start_with(Access::Tokens, limits(Duration::from_secs(2))).await;
    let authenticated = farm.target(Role::Client).connect().await.unwrap();
    call(&authenticated, FITS).await.unwrap();
    let mut unauthenticated = Vec::new();
    for _ in 0..3 {
        unauthenticated.push(farm.tls_channel_without_token().await);
    }
    for channel in &unauthenticated {
        health(channel.clone()).await.unwrap();
    }
    // All connections of this address are in use: the oldest unauthenticated one is evicted, authenticated ones stay.
    assert_eq!(farm.connections.open(), 4);
    let worker = farm.target(Role::Worker).connect().await.unwrap();
    call(&worker, LEASES).await.unwrap();
    drop(worker);
    assert_eq!(farm.connections.refused(), 0);
    call(&authenticated, FITS).await.unwrap();
    // Repeated calls do not keep them open.
    let begun = Instant::now();
    while farm.connections.open() > 1 {
        assert!(begun.elapsed() < SOON);
        sleep(Duration::from_millis(100)).await;
    }
    call(&authenticated, FITS).await.unwrap();
    farm.target(Role::Worker).connect().await.unwrap();
}
