use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpStream, UnixStream};
use tokio::time::{Instant, timeout};
use tonic::transport::server::Connected as _;

use super::*;

const SOON: Duration = Duration::from_secs(5);

async fn listen(limits: Limits) -> (Incoming, SocketAddr) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    (Incoming::new(listener, limits), address)
}

async fn next(incoming: &mut Incoming) -> Guarded {
    timeout(SOON, incoming.accept()).await.unwrap()
}

const LIMITS: Limits = Limits {
    connections: 4,
    hello: HELLO,
    silence: SILENCE,
    unauthenticated: Some(UnauthenticatedLimits { connections: 2, patience: PATIENCE }),
};
const HELLO: Duration = Duration::from_secs(10);
const SILENCE: Duration = Duration::from_mins(1);
const PATIENCE: Duration = Duration::from_secs(30);
const GREETING: [u8; 24] = [0; 24];

/// A connection of an address, and its other end.
fn pair(incoming: &Incoming, address: &str) -> (Guarded, UnixStream) {
    let (here, there) = UnixStream::pair().unwrap();
    let connection = incoming.open.enter(SocketAddr::new(address.parse().unwrap(), 1), false).unwrap();
    (Guarded::new(Either::Right(here), connection, incoming.open.clone()), there)
}

/// As `pair`, after the greeting.
async fn greeted(incoming: &Incoming) -> (Guarded, UnixStream) {
    let (mut guarded, mut there) = pair(incoming, "10.0.0.7");
    there.write_all(&GREETING).await.unwrap();
    guarded.read_exact(&mut [0; GREETING.len()]).await.unwrap();
    (guarded, there)
}

/// Sends single bytes, each after a pause, and then keeps the connection.
fn chatter(mut there: UnixStream, bytes: usize, pause: Duration) {
    tokio::spawn(async move {
        for _ in 0..bytes {
            tokio::time::sleep(pause).await;
            let _ = there.write_all(b".").await;
        }
        std::future::pending::<()>().await;
    });
}

/// The time until a read fails because the connection is cut.
async fn cut_after(guarded: &mut Guarded) -> Duration {
    let start = Instant::now();
    let error = loop {
        match timeout(SILENCE * 4, guarded.read(&mut [0; 64])).await.expect("it ends") {
            Ok(bytes) => assert!(bytes > 0),
            Err(error) => break error,
        }
    };
    assert_eq!(error.kind(), io::ErrorKind::TimedOut);
    start.elapsed()
}

/// No connection is cut before its time, and none much later.
fn about(found: Duration, expected: Duration) {
    assert!(found >= expected && found <= expected + 2 * LOOK, "{found:?} is not {expected:?}");
}

fn admit(guarded: &Guarded) {
    guarded.connection.admit(blake3::hash(b"token"), std::future::pending());
}

/// A peer that does not send the greeting is cut, also if it sends it byte by byte. After the greeting, silence counts from
/// the last byte. A connection without a token ends, however much it sends.
#[tokio::test(start_paused = true)]
async fn overdue_connections_are_cut() {
    let (incoming, _) = listen(LIMITS).await;
    let second = Duration::from_secs(1);
    for (has_begun, admitted, bytes, pause, expected) in [
        (false, false, 0, second, HELLO),
        (false, false, GREETING.len() - 1, second, HELLO),
        (true, true, 5, SILENCE.mul_f64(0.9), SILENCE.mul_f64(5.5)),
        (true, false, 20, 2 * second, PATIENCE),
        (true, true, 20, 2 * second, 40 * second + SILENCE),
    ] {
        let (mut guarded, there) =
            if has_begun { greeted(&incoming).await } else { pair(&incoming, "10.0.0.7") };
        if admitted {
            admit(&guarded);
        }
        chatter(there, bytes, pause);
        about(cut_after(&mut guarded).await, expected);
        assert_eq!(cut_after(&mut guarded).await, Duration::ZERO);
    }
    assert_eq!(incoming.connections().open(), 0);
}

/// A connection is cut when an answer on it is not read in time, when its peer reads nothing, when its token is revoked, or
/// when it sends much without a token.
#[tokio::test(start_paused = true)]
async fn unread_and_revoked_connections_are_cut() {
    let (incoming, _) = listen(LIMITS).await;
    let minute = Duration::from_mins(1);
    let (mut guarded, there) = greeted(&incoming).await;
    chatter(there, 1000, Duration::from_secs(1));
    admit(&guarded);
    drop(guarded.connection.cut_unless_read(minute));
    let _unread = guarded.connection.cut_unless_read(2 * minute);
    assert_eq!(cut_after(&mut guarded).await, 2 * minute);

    let (mut guarded, _there) = pair(&incoming, "10.0.0.7");
    let start = Instant::now();
    let written = timeout(SILENCE * 2, guarded.write_all(&vec![0; 8 << 20])).await.expect("it ends");
    assert_eq!(written.unwrap_err().kind(), io::ErrorKind::TimedOut);
    about(start.elapsed(), HELLO);

    let (mut guarded, there) = greeted(&incoming).await;
    chatter(there, 1000, Duration::from_secs(1));
    let (revoke, revoked) = tokio::sync::oneshot::channel::<()>();
    guarded.connection.admit(blake3::hash(b"token"), async move { drop(revoked.await) });
    assert!(timeout(minute, cut_after(&mut guarded)).await.is_err());
    revoke.send(()).unwrap();
    assert!(cut_after(&mut guarded).await > Duration::from_secs(2), "its calls hear why");

    let (mut guarded, mut there) = pair(&incoming, "10.0.0.7");
    tokio::spawn(async move {
        let _ = there.write_all(&vec![7; 1 << 20]).await;
        std::future::pending::<()>().await;
    });
    assert_eq!(cut_after(&mut guarded).await, Duration::ZERO);
}

/// Beyond the limit, the oldest connection without a token of the same address is cut; others stay.
#[tokio::test(start_paused = true)]
async fn oldest_unauthenticated_peer_is_cut() {
    let (incoming, _) = listen(LIMITS).await;
    let is_cut = |(guarded, _): &(Guarded, UnixStream)| guarded.connection.reason().is_some();
    let first = pair(&incoming, "10.0.0.7");
    admit(&first.0);
    let [second, third] = ["10.0.0.7", "10.0.0.7"].map(|address| pair(&incoming, address));
    let elsewhere = pair(&incoming, "10.0.0.8");
    assert!(![&first, &second, &third, &elsewhere].into_iter().any(is_cut));
    drop(elsewhere);
    let fourth = pair(&incoming, "10.0.0.7");
    assert_eq!([&first, &second, &third, &fourth].map(is_cut), [false, true, false, false]);
    drop((second, third));
    let fifth = pair(&incoming, "10.0.0.7");
    assert!(!is_cut(&fourth) && !is_cut(&fifth));
}

/// Bytes that have arrived are read, even if this process was halted.
#[tokio::test(start_paused = true)]
async fn waiting_bytes_are_read_after_a_delay() {
    let (incoming, _) = listen(LIMITS).await;
    let (mut guarded, mut there) = pair(&incoming, "10.0.0.7");
    there.write_all(&GREETING).await.unwrap();
    tokio::time::advance(SILENCE * 2).await;
    assert_eq!(guarded.read_u8().await.unwrap(), 0);
}

/// Whether the other end has closed the connection.
async fn is_closed(stream: &mut TcpStream) -> bool {
    matches!(timeout(SOON, stream.read(&mut [0])).await, Ok(Ok(0) | Err(_)))
}

/// A connection has the addresses of both ends, and is set to TCP_NODELAY. One above the limit is closed; the others stay.
#[tokio::test]
async fn surplus_connection_is_closed() {
    let (mut incoming, address) = listen(Limits::new(2, None)).await;
    let connections = incoming.connections();
    let connect = || TcpStream::connect(address);
    let mut clients = [connect().await.unwrap(), connect().await.unwrap()];
    let mut places = vec![next(&mut incoming).await, next(&mut incoming).await];
    assert_eq!((connections.open(), connections.refused()), (2, 0));
    assert_eq!(places[0].connect_info().tcp.remote_addr(), clients[0].local_addr().ok());
    let Either::Left(stream) = &places[0].stream else { panic!("it is no TCP connection") };
    assert!(stream.nodelay().unwrap());

    let waiting = tokio::spawn(async move { (next(&mut incoming).await, incoming) });
    for refused in 1..=3 {
        assert!(is_closed(&mut connect().await.unwrap()).await);
        assert_eq!((connections.open(), connections.refused()), (2, refused));
    }
    clients[0].write_all(b"still here").await.unwrap();
    let mut heard = [0; 10];
    places[0].read_exact(&mut heard).await.unwrap();
    assert_eq!(&heard, b"still here");

    places.pop();
    assert_eq!(connections.open(), 1);
    let _another = connect().await.unwrap();
    let (_place, _incoming) = timeout(SOON, waiting).await.unwrap().unwrap();
    assert_eq!((connections.open(), connections.refused()), (2, 3));
}

/// An error of the listener causes a pause, and one of a connection none.
#[tokio::test(start_paused = true)]
async fn listener_errors_cause_a_pause_only() {
    let (incoming, _) = listen(Limits::new(1, None)).await;
    // EMFILE: the process has no file descriptors left.
    for (error, pause) in
        [(io::Error::from_raw_os_error(24), PAUSE), (io::ErrorKind::ConnectionAborted.into(), Duration::ZERO)]
    {
        let start = Instant::now();
        incoming.open.failed(&error).await;
        assert_eq!(start.elapsed(), pause, "{error}");
    }
}

/// Runs the next test in a separate process, since it takes all available file descriptors.
#[test]
fn connections_wait_for_free_file_descriptors() {
    let script = "ulimit -n 64 && exec \"$0\" --exact connections::tests::connections_wait_while_descriptors_are_missing --ignored";
    let this = std::env::current_exe().unwrap();
    let output = std::process::Command::new("sh").args(["-c", script]).arg(this).output().unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && told.contains("1 passed"), "{told}");
}

/// Without free file descriptors, connections wait until there are some.
#[tokio::test]
#[ignore = "takes all file descriptors: another test runs it in a process of its own"]
async fn connections_wait_while_descriptors_are_missing() {
    let (mut incoming, address) = listen(Limits::new(8, None)).await;
    let connect = || TcpStream::connect(address);
    let clients = [connect().await.unwrap(), connect().await.unwrap(), connect().await.unwrap()];
    let taken: Vec<_> = std::iter::from_fn(|| std::fs::File::open("/dev/null").ok()).collect();
    assert!(taken.len() > 3, "the limit is reached with {}", taken.len());
    assert!(timeout(PAUSE * 5, incoming.accept()).await.is_err(), "there is no descriptor for a connection");
    drop(taken);
    for _ in &clients {
        next(&mut incoming).await;
    }
}
