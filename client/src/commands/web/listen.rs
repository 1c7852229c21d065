//! Serves the page's connections within limits.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::extract::Request;
use axum::response::Response;
use farm_link::logs::to_stderr;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::AbortHandle;
use tower::{Service, ServiceExt as _};

/// Largest number of connections: a browser opens six for a page.
const CONNECTIONS: usize = 256;
/// Deadline for the head of a request, and for the beginning of the next one.
const HEADER_TIMEOUT: Duration = Duration::from_secs(30);

/// A connection, and whether the page has authenticated a request on it.
struct PageConnection {
    task: AbortHandle,
    is_let_in: Arc<AtomicBool>,
}

/// Serves connections. At the limit, the oldest unauthenticated connection is closed.
pub(super) async fn serve<S>(listener: TcpListener, service: S) -> std::io::Result<()>
where
    S: Service<Request, Response = Response, Error = Infallible, Future: Send> + Clone + Send + 'static,
{
    serve_within(listener, service, CONNECTIONS, HEADER_TIMEOUT).await
}

async fn serve_within<S>(
    listener: TcpListener,
    service: S,
    most: usize,
    header_timeout: Duration,
) -> std::io::Result<()>
where
    S: Service<Request, Response = Response, Error = Infallible, Future: Send> + Clone + Send + 'static,
{
    let mut connections: Vec<PageConnection> = Vec::new();
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                to_stderr(format_args!("farmctl: a connection was not accepted: {error}"));
                // Out of file descriptors, for example: an immediate retry would only waste CPU time.
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        connections.retain(|connection| !connection.task.is_finished());
        if connections.len() >= most {
            let stranger = connections.iter().position(|c| !c.is_let_in.load(Ordering::Relaxed));
            let Some(stranger) = stranger else { continue };
            connections.remove(stranger).task.abort();
        }
        let is_let_in = Arc::new(AtomicBool::new(false));
        let task = tokio::spawn(converse(stream, service.clone(), is_let_in.clone(), header_timeout));
        connections.push(PageConnection { task: task.abort_handle(), is_let_in });
    }
}

async fn converse<S>(stream: TcpStream, service: S, is_let_in: Arc<AtomicBool>, header_timeout: Duration)
where
    S: Service<Request, Response = Response, Error = Infallible, Future: Send> + Clone + Send + 'static,
{
    let service = service
        .map_request(|request: hyper::Request<hyper::body::Incoming>| request.map(axum::body::Body::new));
    let service = service.map_response(move |response: Response| {
        let good = response.status().is_success() || response.status().is_redirection();
        is_let_in.fetch_or(good, Ordering::Relaxed);
        response
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(header_timeout)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(service));
    // Errors of the connection are ignored: the client may close it at any time.
    let _ = connection.await;
}

#[cfg(test)]
mod tests {
    use axum::http::StatusCode;
    use axum::response::IntoResponse as _;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    use super::*;

    const SOON: Duration = Duration::from_secs(8);

    async fn start(most: usize, header_timeout: Duration) -> std::net::SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let service = tower::service_fn(async |request: Request| {
            let is_owner = request.uri().path() == "/owner";
            Ok::<_, Infallible>(if is_owner { StatusCode::OK } else { StatusCode::FORBIDDEN }.into_response())
        });
        tokio::spawn(serve_within(listener, service, most, header_timeout));
        address
    }

    async fn ask(stream: &mut TcpStream, path: &str) -> Option<String> {
        let request = format!("GET {path} HTTP/1.1\r\nHost: farm\r\n\r\n");
        stream.write_all(request.as_bytes()).await.ok()?;
        let mut answer = vec![0; 4096];
        let bytes = tokio::time::timeout(SOON, stream.read(&mut answer)).await.ok()?.ok()?;
        let answer = String::from_utf8_lossy(&answer[..bytes]).into_owned();
        answer.split(' ').nth(1).map(str::to_owned)
    }

    /// Idle connections are closed in favour of new ones with a request.
    #[tokio::test]
    async fn idle_connections_make_room_for_the_owner() {
        let address = start(8, Duration::from_mins(1)).await;
        let mut owner = TcpStream::connect(address).await.unwrap();
        assert_eq!(ask(&mut owner, "/owner").await.as_deref(), Some("200"));
        let mut strangers = Vec::new();
        for _ in 0..40 {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(b"GET / HT").await.unwrap();
            strangers.push(stream);
        }
        let mut another = TcpStream::connect(address).await.unwrap();
        assert_eq!(ask(&mut another, "/owner").await.as_deref(), Some("200"));
        assert_eq!(
            ask(&mut owner, "/owner").await.as_deref(),
            Some("200"),
            "an admitted connection stays open"
        );
    }

    /// Incomplete requests and idle connections are closed.
    #[tokio::test]
    async fn half_requests_and_idle_connections_end() {
        let address = start(8, Duration::from_millis(300)).await;
        for half in ["", "GET / HT", "GET /owner HTTP/1.1\r\nHost: farm\r\n\r\n"] {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(half.as_bytes()).await.unwrap();
            let mut left = Vec::new();
            let ended = tokio::time::timeout(SOON, stream.read_to_end(&mut left)).await;
            assert!(ended.is_ok(), "{half:?} stays");
        }
    }
}
