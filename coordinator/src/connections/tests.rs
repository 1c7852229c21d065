use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::time::{Instant, timeout};
use tokio_stream::StreamExt as _;
use tonic::transport::server::Connected as _;

use super::*;

const SOON: Duration = Duration::from_secs(5);

async fn listen(connections: usize) -> (Incoming, std::net::SocketAddr) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    (Incoming::new(listener, Limits::new(connections, None)), address)
}

async fn next(incoming: &mut Incoming) -> Guarded<LingeringClose> {
    timeout(SOON, incoming.next()).await.unwrap().unwrap().unwrap()
}

/// Whether the other end has closed the connection.
async fn is_closed(stream: &mut TcpStream) -> bool {
    matches!(timeout(SOON, stream.read(&mut [0])).await, Ok(Ok(0) | Err(_)))
}

/// A connection has the addresses of both ends, and is set to TCP_NODELAY. One above the limit is closed; the others stay.
#[tokio::test]
async fn surplus_connection_is_closed() {
    let (mut incoming, address) = listen(2).await;
    let connections = incoming.connections();
    let connect = || TcpStream::connect(address);
    let mut clients = [connect().await.unwrap(), connect().await.unwrap()];
    let mut places = vec![next(&mut incoming).await, next(&mut incoming).await];
    assert_eq!((connections.open(), connections.refused()), (2, 0));
    assert_eq!(places[0].connect_info().tcp.remote_addr(), clients[0].local_addr().ok());
    assert!(places[0].nodelay());

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

/// An error of the listener causes a pause, not the end of listening.
#[tokio::test(start_paused = true)]
async fn listener_errors_cause_a_pause_only() {
    let (mut incoming, address) = listen(1).await;
    // EMFILE: the process has no file descriptors left.
    incoming.failed(&io::Error::from_raw_os_error(24));
    assert!(incoming.pause.is_some());
    incoming.pause = None;
    incoming.failed(&io::ErrorKind::ConnectionAborted.into());
    assert!(incoming.pause.is_none(), "the next connection has nothing to do with it");
    incoming.failed(&io::Error::from_raw_os_error(24));
    let start = Instant::now();
    let _client = TcpStream::connect(address).await.unwrap();
    next(&mut incoming).await;
    assert!(start.elapsed() >= PAUSE);
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
    let (mut incoming, address) = listen(8).await;
    let connect = || TcpStream::connect(address);
    let clients = [connect().await.unwrap(), connect().await.unwrap(), connect().await.unwrap()];
    let taken: Vec<_> = std::iter::from_fn(|| std::fs::File::open("/dev/null").ok()).collect();
    assert!(taken.len() > 3, "the limit is reached with {}", taken.len());
    assert!(timeout(PAUSE * 5, incoming.next()).await.is_err(), "there is no descriptor for a connection");
    assert!(incoming.pause.is_some());
    drop(taken);
    for _ in &clients {
        next(&mut incoming).await;
    }
}
