//! Watches a call to its end: reports its end to the observer exactly once, and ends it when its token is revoked.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use http::{HeaderMap, Response};
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::{Sleep, sleep};
use tonic::body::Body;
use tonic::{Code, Status};
use tracing::Span;

use super::answer::Answer;
use super::permission::{self, Caller};
use super::request_id::RequestId;
use super::{LOOK, Means, OTHER_METHOD, Shared};
use crate::connections::Admission;

/// A call under way. If it is dropped before its end, the caller has gone.
pub(super) struct Report {
    shared: Arc<Shared>,
    method: String,
    span: Span,
    started: Duration,
    /// The code in the response's header, which is present in an answer without messages.
    code: Option<i32>,
    reported: bool,
    /// Released when the call has ended.
    means: Option<Means>,
    /// The caller whose token admitted the call.
    caller: Option<Caller>,
    connection: Option<Admission>,
}

impl Report {
    pub(super) fn start(
        shared: Arc<Shared>,
        method: String,
        span: Span,
        caller: Option<Caller>,
        connection: Option<Admission>,
    ) -> Self {
        let started = shared.clock.now();
        Self { shared, method, span, started, code: None, reported: false, means: None, caller, connection }
    }

    /// The status that ends the call, if its token has been revoked since it began.
    fn revoked(&self) -> Option<Status> {
        let caller = self.caller.as_ref()?;
        (!permission::is_let_in_still(&self.shared.gate, caller)).then(|| permission::revoked(caller))
    }

    /// Forwards an answer, which is watched until its end.
    pub(super) fn pass<E>(
        mut self,
        answer: Result<Response<Body>, E>,
        id: &RequestId,
        means: Means,
    ) -> Result<Response<ObservedBody>, E> {
        match answer {
            Ok(response) => {
                // The question is answered, so its bytes are released.
                means.account.release();
                self.means = Some(means);
                let response = self.revoked().map_or(response, Status::into_http);
                Ok(self.watch(response, id))
            }
            Err(error) => {
                self.report_end(Code::Unknown as i32);
                Err(error)
            }
        }
    }

    /// The answer to a call that is not admitted. Its method is not reported: callers may invent paths, and no service
    /// has been found at this one.
    pub(super) fn refuse(mut self, status: Status, id: &RequestId) -> Response<ObservedBody> {
        OTHER_METHOD.clone_into(&mut self.method);
        self.watch(status.into_http(), id)
    }

    fn watch(mut self, mut response: Response<Body>, id: &RequestId) -> Response<ObservedBody> {
        id.put_into(response.headers_mut());
        self.code = code(response.headers());
        if response.body().is_end_stream() {
            self.log_end();
        }
        let (means, connection) = (self.means.as_ref(), self.connection.take());
        let answer = means.map(|means| Answer::new(means.account.clone(), connection));
        response.map(|inner| ObservedBody {
            inner,
            answer,
            first: Poll::Pending,
            report: self,
            look: None,
            ended: false,
        })
    }

    /// Reports the end of a stream without trailers.
    fn log_end(&mut self) {
        self.report_end(self.code.unwrap_or(Code::Unknown as i32));
    }

    fn report_end(&mut self, code: i32) {
        if std::mem::replace(&mut self.reported, true) {
            return;
        }
        let unrouted = code == Code::Unimplemented as i32;
        let method = if unrouted { OTHER_METHOD } else { &self.method };
        (self.shared.observer)(method, code, self.shared.clock.now().saturating_sub(self.started));
    }
}

impl Drop for Report {
    fn drop(&mut self) {
        self.report_end(self.code.unwrap_or(Code::Cancelled as i32));
    }
}

fn code(headers: &HeaderMap) -> Option<i32> {
    headers.get(Status::GRPC_STATUS)?.to_str().ok()?.parse().ok()
}

/// A response's body that is watched until its end.
pub struct ObservedBody {
    inner: Body,
    answer: Option<Answer>,
    /// The first frame, if it was fetched before the body was polled.
    first: Poll<Option<Result<Frame<bytes::Bytes>, Status>>>,
    report: Report,
    /// Timer for the next check of the token while a stream waits.
    look: Option<Pin<Box<Sleep>>>,
    /// Whether the stream was ended with a status, because of a revoked token or an exhausted budget.
    ended: bool,
}

impl ObservedBody {
    /// Ends the stream with a status.
    fn end(&mut self, status: &Status) -> Frame<bytes::Bytes> {
        self.ended = true;
        self.answer = None;
        self.report.report_end(status.code() as i32);
        let mut trailers = HeaderMap::new();
        // Adding the status does not fail, since its message is plain text.
        let _ = status.add_header(&mut trailers);
        Frame::trailers(trailers)
    }

    /// Fetches the first frame of the answer, so that it counts even if its caller never polls for it.
    pub(super) async fn fetched(mut self) -> Self {
        std::future::poll_fn(|cx| {
            let _entered = self.report.span.enter();
            self.first = Pin::new(&mut self.inner).poll_frame(cx);
            Poll::Ready(())
        })
        .await;
        if let Poll::Ready(first) = self.take_first() {
            self.first = self.counted(first);
        }
        self
    }

    fn take_first(&mut self) -> Poll<Option<Result<Frame<bytes::Bytes>, Status>>> {
        std::mem::replace(&mut self.first, Poll::Pending)
    }

    /// Accounts for a frame of the answer. Pending if it is a message, which is counted and forwarded in pieces.
    fn counted(
        &mut self,
        frame: Option<Result<Frame<bytes::Bytes>, Status>>,
    ) -> Poll<Option<Result<Frame<bytes::Bytes>, Status>>> {
        let (answer, frame) = match (&mut self.answer, frame) {
            (Some(answer), Some(Ok(frame))) => (answer, frame),
            (_, frame) => return Poll::Ready(frame),
        };
        match frame.into_data() {
            Ok(message) => match answer.take(message) {
                Ok(()) => Poll::Pending,
                Err(status) => Poll::Ready(Some(Ok(self.end(&status)))),
            },
            Err(frame) => Poll::Ready(Some(Ok(frame))),
        }
    }

    /// The next frame of the answer; while there is none, the token is checked every second.
    fn poll_inner(&mut self, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<bytes::Bytes>, Status>>> {
        loop {
            if let Some(status) = self.report.revoked() {
                return Poll::Ready(Some(Ok(self.end(&status))));
            }
            if let Poll::Ready(first) = self.take_first() {
                return Poll::Ready(first);
            }
            if let Some(piece) = self.answer.as_mut().and_then(Answer::next) {
                return Poll::Ready(Some(Ok(piece)));
            }
            // Streams work while they are polled for the next message.
            let entered = self.report.span.clone().entered();
            let polled = Pin::new(&mut self.inner).poll_frame(cx);
            drop(entered);
            if let Poll::Ready(frame) = polled {
                match self.counted(frame) {
                    Poll::Ready(frame) => return Poll::Ready(frame),
                    Poll::Pending => continue,
                }
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
            // A body that ended before it was polled has kept the reason as its first frame.
            let Poll::Ready(reason) = this.take_first() else { return Poll::Ready(None) };
            return Poll::Ready(reason);
        }
        let frame = ready!(this.poll_inner(cx));
        match &frame {
            Some(Ok(frame)) => {
                if let Some(code) = frame.trailers_ref().and_then(code) {
                    this.report.report_end(code);
                }
            }
            Some(Err(status)) => this.report.report_end(status.code() as i32),
            None => this.report.log_end(),
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        if self.answer.as_ref().is_some_and(Answer::has_more) {
            return false;
        }
        // An answer that is a status alone ends with its header: clients refuse one that ends with an empty frame.
        match &self.first {
            Poll::Ready(first) => first.is_none(),
            Poll::Pending => self.ended || self.inner.is_end_stream(),
        }
    }

    fn size_hint(&self) -> SizeHint {
        // Frames that were fetched before are missing from the inner body's size.
        SizeHint::default()
    }
}
