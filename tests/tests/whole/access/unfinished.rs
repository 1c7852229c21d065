//! Requests that would take the memory of a real coordinator: incomplete ones and decompression bombs.

use bytes::Bytes;
use farm_link::Link;
use farm_proto::wire::{FitRequest, MeasuredProfile, Measurement};
use farm_tests::farm::Farm;
use farm_tests::process::{SOON, run, wait_for};
use farm_tests::usage::Usage;
use http_body::Frame;
use http_body_util::StreamBody;
use tokio::task::JoinSet;
use tokio::time::timeout;
use tokio_stream::StreamExt as _;
use tonic::body::Body;
use tonic::client::GrpcService as _;
use tonic::{Code, Status};

/// Bytes that each request sends of a message of twice this size.
const BYTES: usize = 8 << 20;
/// Number of such requests that one token may have open: 128 MiB.
const HELD: usize = 16;

/// Sends half of the announced bytes, then nothing; returns the status of the call.
async fn unfinished(mut link: Link) -> Option<Code> {
    let prefix = [&[0][..], &(2 * BYTES as u32).to_be_bytes()].concat();
    let pieces = std::iter::once(Bytes::from(prefix)).chain((0..8).map(|_| Bytes::from(vec![0; BYTES / 8])));
    let pieces = pieces.map(|piece| Ok::<_, Status>(Frame::data(piece)));
    let body = Body::new(StreamBody::new(tokio_stream::iter(pieces).chain(tokio_stream::pending())));
    let request = http::Request::post("/farm.v1.Fits/Fit")
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(body)
        .unwrap();
    std::future::poll_fn(|cx| link.poll_ready(cx)).await.ok()?;
    let response = link.call(request).await.ok()?;
    Status::from_header_map(response.headers()).map(|status| status.code())
}

/// The incomplete requests of one token are bounded over all its calls, and end when the token is revoked.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn unfinished_requests_are_bounded() {
    let farm = Farm::closed(&[], &[]);
    farm.let_in("client", "mallory");
    wait_for("mallory has access", SOON, || {
        (farm.farmctl_with("keys/mallory.toml", &["list"]).code == 0).then_some(())
    });
    let pid = farm.coordinator().id();
    let link = farm.link_with("keys/mallory.toml");
    let before = Usage::of(pid).unwrap();
    let mut calls = JoinSet::new();
    (0..HELD + 4).for_each(|_| drop(calls.spawn(unfinished(link.clone()))));
    for _ in 0..4 {
        let refused = timeout(SOON, calls.join_next()).await.expect("it is refused at once");
        assert_eq!(refused.unwrap().unwrap(), Some(Code::ResourceExhausted));
    }
    let held_mib = (Usage::of(pid).unwrap().peak_kib - before.peak_kib) >> 10;
    assert!(held_mib < 400, "{held_mib} MiB are held");
    let revoked = run(farm.folder(), &["access", "revoke", "mallory", "--folder", "keys"]);
    assert_eq!(revoked.code, 0, "{}", revoked.stderr);
    // Further ones may have been refused before the refused ones had released their memory.
    for _ in 0..HELD {
        let ended = timeout(SOON, calls.join_next()).await.expect("it is ended").unwrap().unwrap();
        let ends = [None, Some(Code::Unauthenticated), Some(Code::ResourceExhausted)];
        assert!(ends.contains(&ended), "{ended:?}");
    }
}

/// Messages that would grow a hundredfold are refused before they are decoded.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn expanding_message_is_not_decoded() {
    let farm = Farm::start(&[]);
    let profiles = vec![MeasuredProfile::default(); 4 << 20];
    let measurement = Some(Measurement { material: "white".to_owned(), profiles });
    let request = FitRequest { dictionary: "paper".to_owned(), measurement, options: None };
    let before = Usage::of(farm.coordinator().id()).unwrap();
    let refused = farm.fits().fit(request).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
    let grown_mib = (Usage::of(farm.coordinator().id()).unwrap().peak_kib - before.peak_kib) >> 10;
    assert!(grown_mib < 100, "{grown_mib} MiB");
}
