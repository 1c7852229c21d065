//! Limits the size and the duration of calls that need no token.

use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::Sleep;
use tonic::Status;
use tonic::body::Body;

/// Most bytes of such a call: the names of a service or a few.
const BYTES: usize = 4 << 10;
/// Time limit until its body is complete.
const TIME: Duration = Duration::from_secs(10);

/// The body of an open call, with its limits.
struct Limited {
    inner: Body,
    left: usize,
    end: Pin<Box<Sleep>>,
}

/// Limits the body of an open call: it ends with an error beyond its limits.
pub(super) fn limited(inner: Body) -> Body {
    Body::new(Limited { inner, left: BYTES, end: Box::pin(tokio::time::sleep(TIME)) })
}

impl HttpBody for Limited {
    type Data = <Body as HttpBody>::Data;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Status>>> {
        let this = &mut *self;
        if this.end.as_mut().poll(cx).is_ready() {
            let why = format!("without a token a call must end within {} s", TIME.as_secs());
            return Poll::Ready(Some(Err(Status::deadline_exceeded(why))));
        }
        let frame = ready!(Pin::new(&mut this.inner).poll_frame(cx));
        let bytes = frame.as_ref().and_then(|f| f.as_ref().ok()?.data_ref()).map_or(0, bytes::Bytes::len);
        let Some(left) = this.left.checked_sub(bytes) else {
            let why = format!("without a token a call may bring {BYTES} bytes");
            return Poll::Ready(Some(Err(Status::resource_exhausted(why))));
        };
        this.left = left;
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use http_body_util::{BodyExt as _, StreamBody};
    use tokio_stream::StreamExt as _;
    use tonic::Code;

    use super::*;

    fn body(pieces: Vec<usize>, pause: Duration) -> Body {
        let frames = tokio_stream::iter(pieces).then(move |bytes| async move {
            tokio::time::sleep(pause).await;
            Ok::<_, Status>(Frame::data(Bytes::from(vec![0; bytes])))
        });
        Body::new(StreamBody::new(frames))
    }

    async fn read(body: Body) -> Result<usize, Code> {
        limited(body).collect().await.map(|all| all.to_bytes().len()).map_err(|status| status.code())
    }

    /// A call without authorisation has few bytes and little time.
    #[tokio::test(start_paused = true)]
    async fn open_call_is_short_and_small() {
        assert_eq!(read(body(vec![100; 5], Duration::from_secs(1))).await, Ok(500));
        assert_eq!(read(body(vec![BYTES, 1], Duration::ZERO)).await, Err(Code::ResourceExhausted));
        assert_eq!(read(body(vec![1; 100], Duration::from_secs(1))).await, Err(Code::DeadlineExceeded));
        assert_eq!(read(body(vec![1; 2], TIME * 2)).await, Err(Code::DeadlineExceeded));
    }
}
