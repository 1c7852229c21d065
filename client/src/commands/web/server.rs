//! Routes the page's requests.

use std::future::ready;
use std::sync::Arc;

use axum::Router;
use axum::extract::{DefaultBodyLimit, Path, Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, HeaderName, LOCATION, REFERRER_POLICY, SET_COOKIE,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use tokio::net::TcpListener;
use tonic_web::GrpcWebLayer;
use tower::Layer as _;

use super::ask::{PageState, ask};
use super::assets::asset;
use super::forward::Forward;
use super::gate::{PageGate, RequestRefusal, token_of};
use super::listen;

/// Content security policy of the page: it loads its own files only, and nothing inline.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
                      connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'self'";

/// Services of the farm that the page may call.
const FORWARDED: [&str; 5] = ["Dictionaries", "Fits", "Measurements", "Farm", "Admin"];

#[derive(Debug)]
pub(super) struct Server {
    pub gate: Arc<PageGate>,
    pub state: Arc<PageState>,
}

impl Server {
    pub async fn serve(self, listener: TcpListener) -> std::io::Result<()> {
        let (gate, routes) = (Arc::clone(&self.gate), self.routes());
        // The guard wraps all routes: they see addresses relative to the page's folder.
        let guarded = from_fn_with_state(gate, guard).layer(routes);
        listen::serve(listener, guarded).await
    }

    fn routes(self) -> Router {
        let (web, farm) = (GrpcWebLayer::new(), Arc::clone(&self.state.farm));
        let mut router = Router::new()
            .route("/", get(|request: Request| ready(file("", &request))))
            .route("/{name}", get(|Path(name): Path<String>, request: Request| ready(file(&name, &request))))
            .route("/captures/{number}/{name}", get(capture_file))
            // Inputs are not limited: measurements may be as large as for the commands of this process.
            .route("/ask/{verb}", post(ask).layer(DefaultBodyLimit::disable()))
            .with_state(self.state);
        for service in FORWARDED {
            let forward = web.layer(Forward(Arc::clone(&farm)));
            router = router.route_service(&format!("/farm.v1.{service}/{{method}}"), forward);
        }
        router
    }
}

/// Authenticates requests, and sets the security headers of every response.
async fn guard(State(gate): State<Arc<PageGate>>, request: Request, next: Next) -> Response {
    let mut response = answer(&gate, request, next).await.unwrap_or_else(refusal);
    let headers = response.headers_mut();
    let mut say = |name: HeaderName, value: &'static str| {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    };
    say(CONTENT_SECURITY_POLICY, POLICY);
    say(CACHE_CONTROL, "no-store");
    say(X_CONTENT_TYPE_OPTIONS, "nosniff");
    say(REFERRER_POLICY, "no-referrer");
    say(HeaderName::from_static("cross-origin-resource-policy"), "same-origin");
    say(HeaderName::from_static("cross-origin-opener-policy"), "same-origin");
    response
}

async fn answer(gate: &PageGate, mut request: Request, next: Next) -> Result<Response, RequestRefusal> {
    *request.uri_mut() = gate.within(request.uri()).ok_or(RequestRefusal::Token)?;
    if request.uri().path() == "/" && token_of(request.uri()).is_some() {
        let cookie = gate.let_in(&request)?;
        // The redirect removes the token from the address, so that it is not copied by accident.
        return Ok(
            (StatusCode::SEE_OTHER, [(LOCATION, "./".to_owned()), (SET_COOKIE, cookie)]).into_response()
        );
    }
    gate.admit(&request)?;
    Ok(next.run(request).await)
}

fn refusal(refused: RequestRefusal) -> Response {
    let page = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>farmctl web</title><h1>Access denied</h1><p>{}</p>",
        refused.reason()
    );
    (refused.status(), Html(page)).into_response()
}

fn file(name: &str, request: &Request) -> Response {
    asset(name, request.headers()).unwrap_or_else(|| StatusCode::NOT_FOUND.into_response())
}

async fn capture_file(
    State(state): State<Arc<PageState>>,
    Path((number, name)): Path<(String, String)>,
) -> Response {
    let file = state.captures.file(&number, &name).await;
    file.unwrap_or_else(|| StatusCode::NOT_FOUND.into_response())
}
