//! Passes a caller's messages on as long as the token is accepted, they arrive in time, and they fit into the budget of
//! the token's calls.

use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::{Instant, Sleep, sleep};
use tonic::Status;
use tonic::body::Body;

use super::LOOK;
use super::budget::Account;
use super::message::Message;
use super::permission::{self, Caller};
use crate::gate::Gate;

/// Time limit until a message is complete, in addition to the time for its bytes.
const PATIENCE: Duration = Duration::from_secs(30);
/// Slowest rate in bytes per second, from which the time for the bytes follows.
const SLOWEST: usize = 64 << 10;

/// The caller whose token is checked while a call is under way, with its gate; None without a token.
pub(super) type LetIn = Option<(Gate, Caller)>;

struct CallersBody {
    inner: Body,
    let_in: LetIn,
    account: Account,
    /// Whether there are many messages, each of which is passed on before the next.
    streamed: bool,
    message: Message,
    /// Time since which the current message has been waited for; None between the messages of a stream.
    begun: Option<Instant>,
    look: Option<Pin<Box<Sleep>>>,
    /// A frame of a stream that waits until there is room for it.
    waits: Option<Frame<bytes::Bytes>>,
}

/// The body of a caller's request. It ends with an error when the token is revoked, when a message does not arrive in
/// time, and when the token's calls exceed their budget; a stream waits for room instead.
pub(super) fn watched(inner: Body, let_in: LetIn, account: Account, streamed: bool) -> Body {
    let (message, begun) = (Message::default(), Some(Instant::now()));
    Body::new(CallersBody { inner, let_in, account, streamed, message, begun, look: None, waits: None })
}

impl CallersBody {
    /// The status with which the body ends, if the token is revoked or a message is overdue.
    fn ended(&self) -> Option<Status> {
        if let Some((gate, caller)) = &self.let_in
            && !permission::is_let_in_still(gate, caller)
        {
            return Some(permission::revoked(caller));
        }
        let time = PATIENCE + Duration::from_secs((self.message.bytes() / SLOWEST) as u64);
        let overdue = self.begun.is_some_and(|begun| begun.elapsed() >= time);
        overdue.then(|| {
            let seconds = time.as_secs();
            Status::deadline_exceeded(format!(
                "the message of this call did not come whole within {seconds} s"
            ))
        })
    }

    /// Counts received bytes, and notes when the next message begins.
    fn count(&mut self, data: &[u8]) {
        let ended = self.message.take(data);
        if self.streamed {
            let begun = self.begun.filter(|_| !ended);
            self.begun = (!self.message.is_between()).then(|| begun.unwrap_or_else(Instant::now));
        }
    }

    /// Reserves memory for received bytes. In a stream, complete messages are passed on, and no longer count for the call.
    fn hold(&self, data: &[u8]) -> Result<(), Status> {
        if !self.streamed {
            return self.account.hold(data.len());
        }
        self.account.release();
        self.account.hold(if self.message.is_between() { 0 } else { self.message.bytes() })
    }

    /// The next frame, once there is room for it.
    fn poll_inner(&mut self, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<bytes::Bytes>, Status>>> {
        let frame = match self.waits.take() {
            Some(frame) => frame,
            None => match ready!(Pin::new(&mut self.inner).poll_frame(cx)) {
                Some(Ok(frame)) => {
                    frame.data_ref().into_iter().for_each(|data| self.count(data));
                    frame
                }
                ended => return Poll::Ready(ended),
            },
        };
        match frame.data_ref().map_or(Ok(()), |data| self.hold(data)) {
            Ok(()) => Poll::Ready(Some(Ok(frame))),
            Err(_) if self.streamed => {
                self.waits = Some(frame);
                Poll::Pending
            }
            Err(status) => Poll::Ready(Some(Err(status))),
        }
    }
}

impl HttpBody for CallersBody {
    type Data = <Body as HttpBody>::Data;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Status>>> {
        let this = &mut *self;
        loop {
            if let Some(status) = this.ended() {
                return Poll::Ready(Some(Err(status)));
            }
            if let Poll::Ready(frame) = this.poll_inner(cx) {
                return Poll::Ready(frame);
            }
            let look = this.look.get_or_insert_with(|| Box::pin(sleep(LOOK)));
            ready!(look.as_mut().poll(cx));
            this.look = None;
        }
    }

    fn is_end_stream(&self) -> bool {
        self.waits.is_none() && self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use bytes::Bytes;
    use http_body_util::{BodyExt as _, StreamBody};
    use tokio_stream::StreamExt as _;
    use tonic::Code;

    use super::*;
    use crate::authorisation::budget::Budget;

    /// A message of `bytes` bytes, with its prefix.
    fn message(bytes: u32) -> Vec<u8> {
        [&[0][..], &bytes.to_be_bytes(), &vec![7; bytes as usize]].concat()
    }

    fn body(pieces: Vec<Vec<u8>>, pause: Duration, account: &Account, streamed: bool) -> Body {
        let frames = tokio_stream::iter(pieces).then(move |piece| async move {
            sleep(pause).await;
            Ok::<_, Status>(Frame::data(Bytes::from(piece)))
        });
        watched(Body::new(StreamBody::new(frames)), None, account.clone(), streamed)
    }

    fn account(bytes: usize) -> Account {
        Account::new(Arc::new(Budget::of(bytes)), "alice".to_owned())
    }

    async fn read(body: Body) -> Result<usize, Code> {
        body.collect().await.map(|all| all.to_bytes().len()).map_err(|status| status.code())
    }

    /// A message must be complete within the time limit; a stream may pause between messages.
    #[tokio::test(start_paused = true)]
    async fn incomplete_message_times_out() {
        let trickle = |n| message(n).chunks(1).map(<[u8]>::to_vec).collect::<Vec<_>>();
        let (second, late) = (Duration::from_secs(1), Err(Code::DeadlineExceeded));
        for (pieces, pause, streamed, expected) in [
            (trickle(20), second, false, Ok(25)),
            (trickle(40), second, false, late),
            (trickle(40), second, true, late),
            (vec![message(10), message(20), message(30)], PATIENCE / 2, true, Ok(75)),
        ] {
            assert_eq!(read(body(pieces, pause, &account(1000), streamed)).await, expected, "{streamed}");
        }
        let nothing = tokio_stream::pending::<Result<Frame<Bytes>, Status>>();
        let never = watched(Body::new(StreamBody::new(nothing)), None, account(9), false);
        let begun = Instant::now();
        assert_eq!(read(never).await, late);
        assert!(begun.elapsed() < PATIENCE + 2 * LOOK, "{:?}", begun.elapsed());
    }

    /// Bytes of a request count against the budget until they are passed on: a stream waits for room.
    #[tokio::test(start_paused = true)]
    async fn held_bytes_count_until_handed_on() {
        let body = |pieces, account: &Account, streamed| body(pieces, Duration::ZERO, account, streamed);
        let two = || vec![message(60), message(60)];
        assert_eq!(read(body(two(), &account(100), true)).await, Ok(130));
        assert_eq!(read(body(two(), &account(100), false)).await, Err(Code::ResourceExhausted));
        let budget = Arc::new(Budget::of(100));
        let [stream, other] = [(); 2].map(|()| Account::new(budget.clone(), "alice".to_owned()));
        other.hold(90).unwrap();
        let halves = message(30).chunks(20).map(<[u8]>::to_vec).collect();
        let reading = tokio::spawn(read(body(halves, &stream, true)));
        sleep(PATIENCE / 2).await;
        assert!(!reading.is_finished(), "a stream waits for room");
        other.release();
        assert_eq!(reading.await.unwrap(), Ok(35));
        let one = account(100);
        let _held = body(vec![message(80)], &one, false).collect().await.unwrap();
        assert_eq!(read(body(vec![message(60)], &one, false)).await, Err(Code::ResourceExhausted));
    }
}
