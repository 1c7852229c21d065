use std::convert::Infallible;
use std::sync::Mutex;

use http_body::{Body as _, Frame};
use http_body_util::{BodyExt as _, StreamBody};

use super::*;

/// Bytes that the calls of one caller may hold.
const HELD: usize = 1 << 20;

type Told = Arc<Mutex<Vec<(String, i32)>>>;

fn guarded<S>(service: S) -> (Authorised<S>, Told) {
    let told = Told::default();
    let into = told.clone();
    let layer = AuthorisationLayer::new(Gate::Everybody, HELD, move |method, code, _| {
        into.lock().unwrap().push((method.to_owned(), code));
    });
    (layer.layer(service), told)
}

fn request(path: &str) -> Request<Body> {
    Request::builder().uri(path).header("authorization", "Bearer x").body(Body::empty()).unwrap()
}

/// A service whose response `make` builds from the request.
fn answering(
    make: impl Fn(&Request<Body>) -> Response<Body> + Clone,
) -> impl Service<
    Request<Body>,
    Response = Response<Body>,
    Error = Infallible,
    Future = std::future::Ready<Result<Response<Body>, Infallible>>,
> {
    tower::service_fn(move |request: Request<Body>| std::future::ready(Ok(make(&request))))
}

/// A message of this many bytes, and trailers with a code if there is one.
fn answer(bytes: usize, code: Option<&'static str>) -> Response<Body> {
    let message = Frame::data(bytes::Bytes::from(vec![7; bytes]));
    let trailers = code.map(|code| {
        Frame::trailers(http::HeaderMap::from_iter([(Status::GRPC_STATUS, code.parse().unwrap())]))
    });
    let frames = std::iter::once(message).chain(trailers).map(Ok::<_, Status>);
    Response::new(Body::new(StreamBody::new(tokio_stream::iter(frames.collect::<Vec<_>>()))))
}

/// A stream is counted when its trailers have been sent. One that is dropped counts as cancelled, one that ends without a
/// status code as unknown, and one whose call is dropped before its answer as cancelled.
#[tokio::test]
async fn streams_are_counted_at_their_ends() {
    let (mut service, told) =
        guarded(answering(|request| answer(5, (request.uri().path() == "/farm.v1.Fits/Fit").then_some("5"))));
    let response = service.call(request("/farm.v1.Fits/Fit")).await.unwrap();
    assert!(told.lock().unwrap().is_empty(), "the stream has not ended");
    response.into_body().collect().await.unwrap();
    let mut body = service.call(request("/a")).await.unwrap().into_body();
    body.frame().await.unwrap().unwrap();
    drop(body);
    service.call(request("/b")).await.unwrap().into_body().collect().await.unwrap();
    let expected = [("/farm.v1.Fits/Fit", 5), ("/a", 1), ("/b", 2)];
    assert_eq!(*told.lock().unwrap(), expected.map(|(path, code)| (path.to_owned(), code)));
    let (mut service, told) = guarded(tower::service_fn(|_: Request<Body>| {
        std::future::pending::<Result<Response<Body>, Infallible>>()
    }));
    drop(service.call(request("/a")));
    assert_eq!(*told.lock().unwrap(), [("/a".to_owned(), 1)]);
}

/// An empty answer ends with its header: gRPC's own library accepts no empty frame in place of its end. Calls of unknown
/// paths are counted under one name.
#[tokio::test]
async fn empty_answer_is_counted_by_its_header() {
    for (status, path, expected) in [
        (Status::not_found("no"), "/a", ("/a", 5)),
        (Status::unimplemented("no"), "/made/up", (OTHER_METHOD, 12)),
    ] {
        let (mut service, told) = guarded(answering(move |_| status.clone().into_http()));
        let answer = service.call(request(path)).await.unwrap();
        assert!(answer.body().is_end_stream());
        drop(answer);
        assert_eq!(*told.lock().unwrap(), [(expected.0.to_owned(), expected.1)]);
    }
}

/// A handler gets the request id, but not the token.
#[tokio::test]
async fn handlers_get_request_id_but_no_token() {
    let (mut service, _) = guarded(answering(|request| {
        assert!(request.headers().get("authorization").is_none());
        assert!(request.extensions().get::<Caller>().is_none(), "no caller is identified");
        assert_eq!(request.extensions().get::<RequestId>().unwrap().as_str(), "my-id");
        answer(5, Some("0"))
    }));
    let mut request = request("/a");
    request.headers_mut().insert("x-request-id", "my-id".parse().unwrap());
    let response = service.call(request).await.unwrap();
    assert_eq!(response.headers().get("x-request-id").unwrap(), "my-id");
}

/// The bytes of answers that are not yet read are bounded.
#[tokio::test]
async fn unread_answers_are_bounded() {
    let (mut service, told) = guarded(answering(|_| answer(HELD * 2 / 3, Some("0"))));
    let unread = service.call(request("/a")).await.unwrap();
    let refused = service.call(request("/b")).await.unwrap().into_body().collect().await.unwrap();
    assert_eq!(refused.trailers().unwrap().get(Status::GRPC_STATUS).unwrap(), "8");
    assert!(refused.to_bytes().is_empty());
    let read = unread.into_body().collect().await.unwrap();
    assert_eq!(read.trailers().unwrap().get(Status::GRPC_STATUS).unwrap(), "0");
    assert_eq!(read.to_bytes().len(), HELD * 2 / 3);
    service.call(request("/c")).await.unwrap().into_body().collect().await.unwrap();
    let codes: Vec<i32> = told.lock().unwrap().iter().map(|(_, code)| *code).collect();
    assert_eq!(codes, [8, 0, 0]);
}

/// A body of known size must not report the size of its rest after the first frame was fetched.
#[tokio::test]
async fn size_of_an_answer_stays_reported() {
    let whole = || Response::new(Body::new(http_body_util::Full::new(bytes::Bytes::from_static(b"whole"))));
    let (mut service, _) = guarded(answering(move |_| whole()));
    let body = service.call(request("/a")).await.unwrap().into_body();
    assert_ne!(body.size_hint().exact(), Some(0));
    assert_eq!(body.collect().await.unwrap().to_bytes(), "whole");
}

/// A large answer is sent in pieces, with its trailers at the end.
#[tokio::test]
async fn answer_is_sent_in_pieces() {
    let (mut service, _) = guarded(answering(|_| answer(HELD / 2, Some("0"))));
    let mut body = service.call(request("/a")).await.unwrap().into_body();
    let (mut bytes, mut trailers) = (0, false);
    while let Some(frame) = body.frame().await {
        match frame.unwrap().into_data() {
            Ok(piece) => {
                assert!(piece.len() <= 64 << 10, "{}", piece.len());
                bytes += piece.len();
            }
            Err(_) => trailers = true,
        }
    }
    assert_eq!((bytes, trailers), (HELD / 2, true));
}

/// A connection ends if it does not read its answer in time.
#[tokio::test(start_paused = true)]
async fn unread_answer_ends_the_connection() {
    let (mut service, _) = guarded(answering(|_| answer(1000, Some("0"))));
    for (frames, is_cut) in [(0, true), (1, true), (2, false)] {
        let connection = Arc::new(OpenConnection::new(String::new(), false, true));
        let mut request = request("/a");
        let tcp = tonic::transport::server::TcpConnectInfo { local_addr: None, remote_addr: None };
        request.extensions_mut().insert(crate::connections::Peer { tcp, connection: connection.clone() });
        let mut body = service.call(request).await.unwrap().into_body();
        for _ in 0..frames {
            body.frame().await.unwrap().unwrap();
        }
        tokio::time::sleep(Duration::from_secs(200)).await;
        assert_eq!(connection.reason().is_some(), is_cut, "{frames}");
    }
}
