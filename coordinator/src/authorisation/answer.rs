//! Sends an answer to its caller piece by piece, and observes its end.
//!
//! The bytes of a message count against the caller's quota until they are read, and the connection is cut if that takes too
//! long. An answer ends early when the caller's token is revoked.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use bytes::Bytes;
use http::{HeaderMap, Response};
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::task::JoinSet;
use tonic::body::Body;
use tonic::{Code, Status};
use tracing::Span;

use super::{Means, OTHER_METHOD, Shared};

/// Largest piece that is passed to the connection, which keeps it until the caller reads.
const PIECE: usize = 64 << 10;
/// Time limit until a message of an answer is read, in addition to the time for its bytes.
const PATIENCE: Duration = Duration::from_secs(150);
/// Slowest rate in bytes per second, from which the time for the bytes follows.
const SLOWEST: usize = 64 << 10;

/// A call under way, which is observed once. If it is dropped before its end, the caller has gone.
pub(super) struct Call {
    shared: Arc<Shared>,
    method: String,
    started: Duration,
    /// The code in the response's header, which is present in an answer without messages.
    code: Option<i32>,
    is_observed: bool,
}

impl Call {
    pub fn start(shared: Arc<Shared>, method: String) -> Self {
        let started = shared.clock.now();
        Self { shared, method, started, code: None, is_observed: false }
    }

    pub fn end(&mut self, code: i32) {
        if std::mem::replace(&mut self.is_observed, true) {
            return;
        }
        let unrouted = code == Code::Unimplemented as i32;
        let method = if unrouted { OTHER_METHOD } else { &self.method };
        (self.shared.observer)(method, code, self.shared.clock.now().saturating_sub(self.started));
    }

    /// The call is refused. Its method is not observed: callers may invent paths, and no service was found at this one.
    pub fn refuse(mut self, status: &Status) {
        OTHER_METHOD.clone_into(&mut self.method);
        self.end(status.code() as i32);
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        self.end(self.code.unwrap_or(Code::Cancelled as i32));
    }
}

fn code(headers: &HeaderMap) -> Option<i32> {
    headers.get(Status::GRPC_STATUS)?.to_str().ok()?.parse().ok()
}

type Polled = Option<Result<Frame<Bytes>, Status>>;

struct Answer {
    inner: Body,
    means: Means,
    call: Call,
    span: Span,
    /// The rest of a message.
    rest: Bytes,
    /// The frame after the rest, if it is known.
    next: Option<Polled>,
    /// Cuts the connection unless the message is read in time.
    unread: Option<JoinSet<()>>,
    has_ended: bool,
}

/// The response with a body that is watched until its end. Its first message counts even if its caller never asks for it.
pub(super) async fn watched(response: Response<Body>, means: Means, mut call: Call) -> Response<Body> {
    call.code = code(response.headers());
    let (head, inner) = response.into_parts();
    if inner.is_end_stream() {
        call.end(call.code.unwrap_or(Code::Unknown as i32));
    }
    let (rest, span) = (Bytes::new(), Span::current());
    let mut answer = Answer { inner, means, call, span, rest, next: None, unread: None, has_ended: false };
    std::future::poll_fn(|cx| {
        let _ = answer.poll_message(cx);
        Poll::Ready(())
    })
    .await;
    Response::from_parts(head, Body::new(answer))
}

impl Answer {
    /// Takes the next message, or what comes after the last one.
    fn poll_message(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        // Streams work while they are polled for the next message.
        let frame = {
            let _entered = self.span.enter();
            ready!(Pin::new(&mut self.inner).poll_frame(cx))
        };
        self.next = Some(match frame.map(|frame| frame.map(Frame::into_data)) {
            Some(Ok(Ok(message))) => match self.take(message) {
                Ok(()) => return Poll::Ready(()),
                Err(status) => Some(Ok(self.last(&status))),
            },
            Some(Ok(Err(trailers))) => Some(Ok(trailers)),
            Some(Err(status)) => Some(Err(status)),
            None => None,
        });
        Poll::Ready(())
    }

    fn take(&mut self, message: Bytes) -> Result<(), Status> {
        self.means.bytes.more(message.len() as u64)?;
        let time = PATIENCE + Duration::from_secs((message.len() / SLOWEST) as u64);
        self.unread = self.means.connection.as_ref().map(|connection| connection.cut_unless_read(time));
        self.rest = message;
        Ok(())
    }

    /// The end of the answer with a status.
    fn last(&mut self, status: &Status) -> Frame<Bytes> {
        self.has_ended = true;
        let mut trailers = HeaderMap::new();
        // Adding the status does not fail, since its message is plain text.
        let _ = status.add_header(&mut trailers);
        Frame::trailers(trailers)
    }

    fn observe(&mut self, next: &Polled) {
        match next {
            Some(Ok(frame)) => {
                if let Some(code) = frame.trailers_ref().and_then(code) {
                    self.call.end(code);
                }
            }
            Some(Err(status)) => self.call.end(status.code() as i32),
            None => self.call.end(self.call.code.unwrap_or(Code::Unknown as i32)),
        }
    }
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Polled> {
        let this = self.get_mut();
        loop {
            if !this.has_ended
                && let Poll::Ready(status) = this.means.revoked.as_mut().poll(cx)
            {
                this.rest.clear();
                this.next = Some(Some(Ok(this.last(&status))));
            }
            if !this.rest.is_empty() {
                let piece = this.rest.split_to(PIECE.min(this.rest.len()));
                return Poll::Ready(Some(Ok(Frame::data(piece))));
            }
            // The last piece of the message was taken.
            if this.unread.take().is_some() || this.means.connection.is_none() {
                this.means.bytes.give_back();
            }
            if let Some(next) = this.next.take() {
                this.observe(&next);
                return Poll::Ready(next);
            }
            if this.has_ended {
                return Poll::Ready(None);
            }
            ready!(this.poll_message(cx));
        }
    }

    fn is_end_stream(&self) -> bool {
        // An answer that is a status alone ends with its header: clients refuse one that ends with an empty frame.
        let has_no_more = match &self.next {
            Some(next) => next.is_none(),
            None => self.has_ended || self.inner.is_end_stream(),
        };
        self.rest.is_empty() && has_no_more
    }

    fn size_hint(&self) -> SizeHint {
        // The first message is missing from the inner body's size.
        SizeHint::default()
    }
}
