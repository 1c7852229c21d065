//! Passes on what a caller sends, if it comes at a least rate, and if it fits into the caller's quota of bytes.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use bytes::Bytes;
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::{Instant, Sleep, sleep};
use tonic::Status;
use tonic::body::Body;

use crate::quota::Held;

/// Longest time that a caller may be waited for, beyond the time in which its bytes come at the least rate.
const PATIENCE: Duration = Duration::from_secs(15);
/// Least rate, in bytes per second.
const LEAST_RATE: f64 = 65_536.0;

struct Question {
    inner: Body,
    held: Option<Arc<Held>>,
    /// Time for which the caller may still be waited for. It shrinks by waiting, and grows with each byte, so that neither a
    /// pause nor a trickle holds a call.
    patience: Duration,
    /// Time since which the next bytes are awaited. While they are not, the delay is on this side.
    since: Option<Instant>,
    end: Pin<Box<Sleep>>,
}

/// The body of a question, which ends with an error when it comes too slowly or holds too many bytes. A stream, whose
/// messages do not stay, holds none.
pub(super) fn watched(inner: Body, held: Option<Arc<Held>>) -> Body {
    Body::new(Question { inner, held, patience: PATIENCE, since: None, end: Box::pin(sleep(PATIENCE)) })
}

impl HttpBody for Question {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        let Poll::Ready(frame) = Pin::new(&mut this.inner).poll_frame(cx) else {
            if this.since.is_none() {
                let now = Instant::now();
                this.since = Some(now);
                this.end.as_mut().reset(now + this.patience);
            }
            ready!(this.end.as_mut().poll(cx));
            let why = format!("the request came more slowly than {} kB per second", LEAST_RATE as u64 / 1000);
            return Poll::Ready(Some(Err(Status::deadline_exceeded(why))));
        };
        if let Some(since) = this.since.take() {
            this.patience = this.patience.saturating_sub(since.elapsed());
        }
        if let Some(Ok(frame)) = &frame
            && let Some(data) = frame.data_ref()
        {
            let time = Duration::from_secs_f64(data.len() as f64 / LEAST_RATE);
            this.patience = PATIENCE.min(this.patience + time);
            if let Some(Err(exhausted)) = this.held.as_ref().map(|held| held.more(data.len() as u64)) {
                return Poll::Ready(Some(Err(exhausted.into())));
            }
        }
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
    use http_body_util::{BodyExt as _, StreamBody};
    use tokio_stream::StreamExt as _;
    use tonic::Code;

    use super::*;
    use crate::quota::{Limit, Quota};

    /// The bytes of a question that comes in pieces of this size, each after a pause, and the code if it is cut.
    async fn read(pauses_s: Vec<u64>, bytes: usize, held: Option<Arc<Held>>) -> Result<usize, Code> {
        let frames = tokio_stream::iter(pauses_s).then(move |pause_s| async move {
            sleep(Duration::from_secs(pause_s)).await;
            Ok::<_, Status>(Frame::data(Bytes::from(vec![7; bytes])))
        });
        let question = watched(Body::new(StreamBody::new(frames)), held);
        question.collect().await.map(|all| all.to_bytes().len()).map_err(|status| status.code())
    }

    /// Neither a trickle nor a pause holds a call, however much came before; a slow caller is waited for.
    #[tokio::test(start_paused = true)]
    async fn trickling_question_ends_soon() {
        let late = Err(Code::DeadlineExceeded);
        for (pauses_s, bytes, expected) in [
            (vec![1; 14], 1, Ok(14)),
            (vec![1; 40], 1, late),
            (vec![1, 16], 8 << 20, late),
            (vec![1; 40], 64 << 10, Ok(40 << 16)),
            (vec![1; 40], 48 << 10, Ok(40 * (48 << 10))),
            (vec![1; 400], 48 << 10, late),
        ] {
            assert_eq!(read(pauses_s.clone(), bytes, None).await, expected, "{pauses_s:?} {bytes}");
        }
        let begun = Instant::now();
        let _ = watched(Body::new(StreamBody::new(tokio_stream::pending::<Result<_, Status>>())), None)
            .collect()
            .await
            .unwrap_err();
        assert_eq!(begun.elapsed(), PATIENCE);
    }

    /// The time in which nothing is asked of the caller does not count.
    #[tokio::test(start_paused = true)]
    async fn delay_on_this_side_is_no_slowness() {
        let frames = tokio_stream::iter(0..3).map(|_| Ok::<_, Status>(Frame::data(Bytes::from_static(b"x"))));
        let mut question = watched(Body::new(StreamBody::new(frames)), None);
        for _ in 0..3 {
            sleep(PATIENCE * 2).await;
            question.frame().await.unwrap().unwrap();
        }
    }

    /// The bytes of a question count until it is answered.
    #[tokio::test(start_paused = true)]
    async fn bytes_of_a_question_count() {
        let quota = Quota::new("bytes", "wait");
        let held = || Arc::new(quota.hold(vec![Limit::new("alice", 100)], 0).unwrap());
        let first = held();
        assert_eq!(read(vec![0], 80, Some(first.clone())).await, Ok(80));
        assert_eq!(read(vec![0], 60, Some(held())).await, Err(Code::ResourceExhausted));
        drop(first);
        assert_eq!(read(vec![0], 60, Some(held())).await, Ok(60));
    }
}
