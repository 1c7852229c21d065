//! A proxy of HTTP/1.1 that shows a server below a prefix, as those of laboratories do.

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

/// Takes requests below `/PREFIX/` and hands them on without it, with the headers that it was given.
#[derive(Debug)]
pub struct ReverseProxy {
    pub address: SocketAddr,
    task: JoinHandle<()>,
}

#[derive(Debug, Clone)]
struct Onward {
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
        let onward = Onward { client, target: target.to_owned(), prefix: format!("/{prefix}/") };
        let routes = Router::new().fallback(hand_on).with_state(onward);
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

async fn hand_on(State(onward): State<Onward>, mut request: Request) -> Response {
    let asked = request.uri().path_and_query().map_or("", |asked| asked.as_str());
    let Some(below) = asked.strip_prefix(&onward.prefix) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    let Ok(uri) = format!("http://{}/{below}", onward.target).parse::<Uri>() else {
        return StatusCode::BAD_REQUEST.into_response();
    };
    *request.uri_mut() = uri;
    match onward.client.request(request).await {
        Ok(answer) => answer.map(Body::new),
        Err(_) => StatusCode::BAD_GATEWAY.into_response(),
    }
}
