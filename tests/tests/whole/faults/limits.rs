//! Limits: messages that are too large, and too many connections.

use std::convert::Infallible;
use std::time::Duration;

use bytes::Bytes;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_proto::wire::{GetRequest, ListFailedRequest};
use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{SOON, wait_for};
use http_body_util::StreamBody;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::net::TcpStream;
use tokio::time::Instant;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};

use super::{GRID, JOBS};

const MIB: u64 = 1024;
/// Connections that the coordinator accepts at a time.
const PLACES: usize = 256;
const REFUSED: &str = "farm_connections_refused_total";

/// Sends one message of 1 GiB as a call of `path`, piece by piece, while the other end accepts it.
async fn send_huge(mut link: Channel, path: &str) -> Status {
    use http_body_util::BodyExt;
    use tower::{Service, ServiceExt};
    const PIECE: usize = 64 << 10;
    let prefix = [&[0_u8][..], &(1_u32 << 30).to_be_bytes()].concat();
    let pieces = std::iter::once(Bytes::from(prefix))
        .chain(std::iter::repeat_n(Bytes::from(vec![0; PIECE]), (1 << 30) / PIECE));
    let frames = pieces.map(|piece| Ok::<_, Infallible>(http_body::Frame::data(piece)));
    let body = tonic::body::Body::new(StreamBody::new(tokio_stream::iter(frames)));
    let request =
        http::Request::post(path).header("content-type", "application/grpc").header("te", "trailers");
    let answer = link.ready().await.unwrap().call(request.body(body).unwrap()).await.unwrap();
    let (head, body) = answer.into_parts();
    if let Some(status) = Status::from_header_map(&head.headers) {
        return status;
    }
    let end = tokio::time::timeout(SOON, body.collect()).await.expect("the call ends").unwrap();
    Status::from_header_map(end.trailers().expect("a call ends with trailers")).unwrap()
}

/// A message of 1 GB is refused without taking its memory.
#[tokio::test(flavor = "multi_thread")]
async fn huge_message_takes_no_memory() {
    let farm = Farm::start(&["--insecure"]);
    farm.submit("grid", GRID);
    let before = farm.coordinator().usage().unwrap().resident_kib;
    let root = format!("{}/farm.v1.", farm.url());
    for method in ["Dictionaries/Submit", "Fits/Fit", "Leases/Complete", "Leases/Renew"] {
        let status = send_huge(farm.channel().await, &format!("{root}{method}")).await;
        assert!(matches!(status.code(), Code::OutOfRange | Code::ResourceExhausted), "{method}: {status:?}");
    }
    let grown = farm.coordinator().usage().unwrap().peak_kib.saturating_sub(before);
    println!("the coordinator grew by {} MiB at most", grown / MIB);
    assert!(grown < 64 * MIB, "it grew by {grown} KiB");
    let worker = farm.worker("worker", &[]);
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    drop(worker);
}

/// Raises this process's limit of open files if permitted; returns the possible number of connections.
fn files_allowed() -> usize {
    let limit = getrlimit(Resource::Nofile);
    let raised = Rlimit { current: limit.maximum, maximum: limit.maximum };
    // Without permission the limit stays as it was.
    let _ = setrlimit(Resource::Nofile, raised);
    getrlimit(Resource::Nofile).current.map_or(usize::MAX, |n| n as usize)
}

/// Opens connections in groups, and waits until refused ones are closed. If they were opened faster than accepted, they
/// would overflow the system's queue, which answers with SYN cookies: a connection then exists at one end only, until
/// it sends.
async fn connect(port: u16, count: usize) -> Vec<TcpStream> {
    // Well below the listener's queue of 1,024, including those that are accepted.
    const AT_ONCE: usize = 2 * PLACES;
    let mut opened = Vec::with_capacity(count);
    while opened.len() < count {
        let from = opened.len();
        for _ in 0..AT_ONCE.min(count - from) {
            opened.push(TcpStream::connect(("127.0.0.1", port)).await.unwrap());
        }
        let new = &opened[from..];
        let too_many = new.len().saturating_sub(PLACES);
        wait_for("those too many are closed", SOON, || (closed(new) >= too_many).then_some(()));
    }
    opened
}

/// Whether a new client is served. A call on a connection that is closed at once may have no end.
async fn gets_in(farm: &Farm) -> bool {
    let served = async {
        let Ok(link) = Endpoint::from_shared(farm.url()).unwrap().connect().await else { return false };
        let request = GetRequest { name: "grid".to_owned() };
        DictionariesClient::new(link).get(request).await.is_ok()
    };
    tokio::time::timeout(Duration::from_secs(2), served).await.unwrap_or(false)
}

/// Number of connections that the other end has closed.
fn closed(streams: &[TcpStream]) -> usize {
    let is_closed = |stream: &&TcpStream| match stream.try_read(&mut [0; 64]) {
        Ok(bytes) => bytes == 0,
        Err(error) => error.kind() != std::io::ErrorKind::WouldBlock,
    };
    streams.iter().filter(is_closed).count()
}

/// 10,000 idle connections take little memory, and are closed after 10 s in favour of other clients.
#[tokio::test(flavor = "multi_thread")]
async fn idle_connections_do_not_hinder_existing_ones() {
    let count = 10_000.min(files_allowed().saturating_sub(1000));
    if count < 10_000 {
        eprintln!("only {count} connections: this process may not open more files");
    }
    let farm = Farm::start(&["--insecure", "--max-connections", &PLACES.to_string()]);
    farm.submit("grid", GRID);
    let mut dictionaries = DictionariesClient::new(farm.channel().await);
    let mut get = async || dictionaries.get(GetRequest { name: "grid".to_owned() }).await;
    let worker = farm.worker("worker", &[]);
    farm.leased("grid", 1);
    get().await.unwrap();
    let before = farm.coordinator().usage().unwrap().resident_kib;
    let start = Instant::now();
    let idle = connect(farm.port(), count).await;
    // Silent connections are closed after 10 s in favour of others.
    let rounds = 2 + start.elapsed().as_secs() as usize / 10;
    let least = (count - rounds * PLACES) as u64;
    wait_for("the others are refused", SOON, || (farm.figure(REFUSED) >= least).then_some(()));
    wait_for("they are closed", SOON, || (closed(&idle) as u64 >= least).then_some(()));
    // An earlier client and worker continue.
    get().await.unwrap();
    let stored = r#"farm_jobs_completed_total{outcome="stored"}"#;
    wait_for("the worker's results come in", SOON * 2, || (farm.figure(stored) == JOBS).then_some(()));
    let grown = farm.coordinator().usage().unwrap().peak_kib.saturating_sub(before);
    println!("{count} connections: the coordinator grew by {} MiB at most", grown / MIB);
    assert!(grown < 64 * MIB, "it grew by {grown} KiB");
    // Idle connections without a greeting are closed; then others are accepted.
    let deadline = Instant::now() + SOON;
    while !gets_in(&farm).await {
        assert!(Instant::now() < deadline, "no new client is served");
    }
    let log = farm.coordinator().log();
    assert!(
        log.contains("connections have been cut, the last one because the other end does not begin"),
        "{log}"
    );
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    drop((idle, worker));
}

/// The jobs that were given up are listed in pages.
#[tokio::test(flavor = "multi_thread")]
async fn failed_jobs_are_listed_in_pages() {
    let farm = Farm::start(&["--max-attempts", "1"]);
    farm.submit("grid", GRID);
    let mut worker = farm.test_worker("test").await.unwrap();
    let leases = worker.acquire(2).await.unwrap();
    for lease in &leases {
        worker.fail(lease, "no space left").await.unwrap();
    }
    let (mut failed, mut page_token) = (Vec::new(), String::new());
    for _ in 0..leases.len() {
        let request = ListFailedRequest { name: "grid".to_owned(), page_size: 1, page_token };
        let page = farm.dictionaries().list_failed(request).await.unwrap().into_inner();
        assert_eq!(page.failed.len(), 1);
        failed.extend(page.failed.into_iter().map(|failed| failed.job));
        page_token = page.next_page_token;
    }
    assert_eq!(page_token, "", "the last page has no token");
    let mut expected: Vec<u32> = leases.iter().map(|lease| lease.key.job).collect();
    expected.sort_unstable();
    assert_eq!(failed, expected);
    let bad = ListFailedRequest { name: "grid".to_owned(), page_size: 1, page_token: "x".to_owned() };
    assert_eq!(farm.dictionaries().list_failed(bad).await.unwrap_err().code(), Code::InvalidArgument);
}
