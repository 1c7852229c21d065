//! Clients that send or read slowly.

use std::convert::Infallible;
use std::time::Duration;

use bytes::Bytes;
use farm_proto::wire::ExportRequest;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_tests::farm::Farm;
use farm_tests::grids::{traced, undisturbed};
use farm_tests::test_worker::on_wire;
use http_body_util::StreamBody;
use prost::Message;
use tokio_stream::StreamExt;
use tonic::{Code, Status};
use tower::{Service, ServiceExt};

use super::GRID;

/// 96 records of some 0.4 MB: far more than the buffers of a link.
const LARGE: &str = "\
sigma_t_per_mm = [1, 2, 4, 8]
albedo = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
g = [0.0, 0.1, 0.2]
thickness_mm = [0.5]
walks = 5000
derivatives = true
";

/// A call that delivers a valid result byte by byte after its header, while its lease lasts, and would take hours; returns
/// its code.
async fn trickle(farm: &Farm) -> tokio::task::JoinHandle<Option<Code>> {
    let grid = farm_tests::grids::grid_of(GRID);
    let mut worker = farm.test_worker("slow").await.unwrap();
    let lease = worker.acquire(1).await.unwrap().remove(0);
    let messages = worker.messages(&lease, on_wire(&traced(&grid, lease.key.job as usize)));
    let mut framed = messages.into_iter().map(|part| {
        let message = part.encode_to_vec();
        [&[0][..], &(message.len() as u32).to_be_bytes(), &message].concat()
    });
    let header = framed.next().unwrap();
    let rest =
        tokio_stream::iter(framed.flatten()).map(|byte| vec![byte]).throttle(Duration::from_millis(20));
    let frames = tokio_stream::iter([header])
        .chain(rest)
        .map(|bytes| Ok::<_, Infallible>(http_body::Frame::data(Bytes::from(bytes))));
    let body = tonic::body::Body::new(StreamBody::new(frames));
    let request = http::Request::post(format!("{}/farm.v1.Leases/Complete", farm.url()))
        .header("content-type", "application/grpc")
        .header("te", "trailers");
    let (mut link, request) = (farm.channel().await, request.body(body).unwrap());
    tokio::spawn(async move {
        let answer = link.ready().await.unwrap().call(request).await.ok()?;
        Status::from_header_map(answer.headers()).map(|status| status.code())
    })
}

/// Slow clients take little memory, and do not delay a stop. A slow sender is not waited for, so that it holds no room.
#[tokio::test(flavor = "multi_thread")]
async fn slow_clients_do_not_hinder_others() {
    let mut farm = Farm::start(&["--insecure", "--lease", "2"]);
    farm.submit("large", LARGE);
    let worker = farm.worker("worker", &[]);
    farm.done("large");
    drop(worker);
    farm.submit("grid", GRID);
    let before = farm.coordinator().usage().unwrap().resident_kib;
    let mut slow = Vec::new();
    for _ in 0..4 {
        slow.push(trickle(&farm).await);
    }
    // Clients that request all records and read one.
    let mut unread = Vec::new();
    for _ in 0..32 {
        let request = ExportRequest { name: "large".to_owned(), ..Default::default() };
        let mut stream =
            DictionariesClient::new(farm.channel().await).export(request).await.unwrap().into_inner();
        assert!(stream.message().await.unwrap().is_some());
        unread.push(stream);
    }
    let worker = farm.worker("worker", &[]);
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert_eq!(farm.farmctl(&["export", "large", "-o", "all.csv"]).code, 0);
    let grown = farm.coordinator().usage().unwrap().peak_kib.saturating_sub(before);
    println!("36 slow clients: the coordinator grew by {} MiB at most", grown / 1024);
    assert!(grown < 512 << 10, "it grew by {grown} KiB");
    for call in slow {
        let ended = tokio::time::timeout(Duration::from_secs(20), call).await.expect("it is cut soon");
        assert_eq!(ended.unwrap(), Some(Code::DeadlineExceeded));
    }
    assert_eq!(farm.stop_coordinator(), 0, "it ends within 10 s");
    drop((unread, worker));
}
