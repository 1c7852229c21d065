//! Runs an HTTP/1.1 reverse proxy that serves a server below a path prefix.

use std::net::SocketAddr;

use axum::Router;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse as _, Response};
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

/// Forwards requests below `/PREFIX/` without the prefix, with their original headers.
#[derive(Debug)]
pub struct ReverseProxy {
    pub address: SocketAddr,
    task: JoinHandle<()>,
}

#[derive(Debug, Clone)]
struct Upstream {
    client: Client<HttpConnector, Body>,
    target: String,
    prefix: String,
}

impl ReverseProxy {
    /// Listens on loopback for a server at `target`, which need not be there yet. The prefix has no slashes.
    ///
    /// # Panics
    /// If no port can be opened.
    pub async fn start(target: &str, prefix: &str) -> Self {
        let client = Client::builder(TokioExecutor::new()).build_http();
        let upstream = Upstream { client, target: target.to_owned(), prefix: format!("/{prefix}/") };
        let routes = Router::new().fallback(forward).with_state(upstream);
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port on loopback");
        let address = listener.local_addr().expect("it has an address");
        let task = tokio::spawn(async move {
            let _ = axum::serve(listener, routes).await;
        });
        Self { address, task }
    }
}

impl Drop for ReverseProxy {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn forward(State(upstream): State<Upstream>, mut request: Request) -> Response {
    let asked = request.uri().path_and_query().map_or("", |asked| asked.as_str());
    let Some(below) = asked.strip_prefix(&upstream.prefix) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let Ok(uri) = format!("http://{}/{below}", upstream.target).parse::<Uri>() else {
        return StatusCode::BAD_REQUEST.into_response();
    };
    *request.uri_mut() = uri;
    match upstream.client.request(request).await {
        Ok(answer) => answer.map(Body::new),
        Err(_) => StatusCode::BAD_GATEWAY.into_response(),
    }
}
