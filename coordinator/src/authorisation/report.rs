//! Watches a call to its end: tells the observer how it has ended, exactly once, and ends it when its token is revoked.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use http::{HeaderMap, Response};
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::{Sleep, sleep};
use tonic::body::Body;
use tonic::{Code, Status};
use tracing::Span;

use super::permission::{self, Caller};
use super::request_id::RequestId;
use super::{OTHER_METHOD, Shared};

/// How often a stream that waits looks whether its token is let in.
const LOOK: Duration = Duration::from_secs(1);

/// A call under way. If it is dropped, the caller has gone.
pub(super) struct Report {
    shared: Arc<Shared>,
    method: String,
    span: Span,
    started: Duration,
    /// The code in the response's header, which an answer without messages has.
    code: Option<i32>,
    told: bool,
    /// Given back when the call has ended.
    place: Option<OwnedSemaphorePermit>,
    /// By whose token it was let in.
    caller: Option<Caller>,
}

impl Report {
    pub(super) fn start(shared: Arc<Shared>, method: String, span: Span, caller: Option<Caller>) -> Self {
        let started = shared.clock.now();
        Self { shared, method, span, started, code: None, told: false, place: None, caller }
    }

    /// What the caller is told if their token has been revoked since the call began.
    fn revoked(&self) -> Option<Status> {
        let caller = self.caller.as_ref()?;
        (!permission::is_let_in_still(&self.shared.gate, caller)).then(|| permission::revoked(caller))
    }

    /// Sends an answer on, to be watched until its end.
    pub(super) fn pass<E>(
        mut self,
        answer: Result<Response<Body>, E>,
        id: &RequestId,
        place: Option<OwnedSemaphorePermit>,
    ) -> Result<Response<ObservedBody>, E> {
        match answer {
            Ok(response) => {
                self.place = place;
                let response = self.revoked().map_or(response, Status::into_http);
                Ok(self.watch(response, id))
            }
            Err(error) => {
                self.tell(Code::Unknown as i32);
                Err(error)
            }
        }
    }

    /// The answer to a call that is not let in. Which method it was after is not told: its path is the caller's invention
    /// as long as nothing has been found there.
    pub(super) fn refuse(mut self, status: Status, id: &RequestId) -> Response<ObservedBody> {
        OTHER_METHOD.clone_into(&mut self.method);
        self.watch(status.into_http(), id)
    }

    fn watch(mut self, mut response: Response<Body>, id: &RequestId) -> Response<ObservedBody> {
        id.put_into(response.headers_mut());
        self.code = code(response.headers());
        if response.body().is_end_stream() {
            self.tell_end();
        }
        response.map(|inner| ObservedBody { inner, report: self, look: None, ended: false })
    }

    /// The stream has ended without trailers.
    fn tell_end(&mut self) {
        self.tell(self.code.unwrap_or(Code::Unknown as i32));
    }

    fn tell(&mut self, code: i32) {
        if std::mem::replace(&mut self.told, true) {
            return;
        }
        let unrouted = code == Code::Unimplemented as i32;
        let method = if unrouted { OTHER_METHOD } else { &self.method };
        (self.shared.observer)(method, code, self.shared.clock.now().saturating_sub(self.started));
    }
}

impl Drop for Report {
    fn drop(&mut self) {
        self.tell(self.code.unwrap_or(Code::Cancelled as i32));
    }
}

fn code(headers: &HeaderMap) -> Option<i32> {
    headers.get(Status::GRPC_STATUS)?.to_str().ok()?.parse().ok()
}

/// A response's body, watched.
pub struct ObservedBody {
    inner: Body,
    report: Report,
    /// When to look again at the token of a stream that waits.
    look: Option<Pin<Box<Sleep>>>,
    /// By a revoked token.
    ended: bool,
}

impl ObservedBody {
    /// Ends the stream with a status.
    fn end(&mut self, status: &Status) -> Frame<bytes::Bytes> {
        self.ended = true;
        self.report.tell(status.code() as i32);
        let mut trailers = HeaderMap::new();
        // What is told is plain text.
        let _ = status.add_header(&mut trailers);
        Frame::trailers(trailers)
    }

    /// The next frame of the answer; while there is none, a look at the token each second.
    fn poll_inner(&mut self, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<bytes::Bytes>, Status>>> {
        loop {
            if let Some(status) = self.report.revoked() {
                return Poll::Ready(Some(Ok(self.end(&status))));
            }
            // Streams do their work while they are asked for the next message.
            let _entered = self.report.span.enter();
            if let Poll::Ready(frame) = Pin::new(&mut self.inner).poll_frame(cx) {
                return Poll::Ready(frame);
            }
            if self.report.caller.is_none() {
                return Poll::Pending;
            }
            let look = self.look.get_or_insert_with(|| Box::pin(sleep(LOOK)));
            ready!(look.as_mut().poll(cx));
            self.look = None;
        }
    }
}

impl std::fmt::Debug for ObservedBody {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ObservedBody").field("method", &self.report.method).finish_non_exhaustive()
    }
}

impl HttpBody for ObservedBody {
    type Data = <Body as HttpBody>::Data;
    type Error = Status;

    fn poll_frame(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Status>>> {
        let this = self.get_mut();
        if this.ended {
            return Poll::Ready(None);
        }
        let frame = ready!(this.poll_inner(cx));
        match &frame {
            Some(Ok(frame)) => {
                if let Some(code) = frame.trailers_ref().and_then(code) {
                    this.report.tell(code);
                }
            }
            Some(Err(status)) => this.report.tell(status.code() as i32),
            None => this.report.tell_end(),
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.ended || self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}
