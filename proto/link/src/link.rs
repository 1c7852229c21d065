//! Connects to a coordinator such that every call carries a token, ends in time, and reports why it is refused.

use std::error::Error;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use tonic::body::Body;
use tonic::codegen::{Service, http};
use tonic::transport::Channel;
use tonic::{ConnectError, Status, TimeoutExpired};

use crate::alert::refusal;
use crate::endpoint::Bearer;
use crate::handshake::Handshake;

/// Default timeout of a call until its first answer.
const DEADLINE: Duration = Duration::from_mins(5);
/// Time after its deadline at which a call is given up here: the other side, or the transport, may still report the reason.
const GRACE: Duration = Duration::from_secs(2);
/// Time after which a call on a link without any answer so far makes a handshake, to check whether the certificate is
/// refused.
const SILENCE: Duration = Duration::from_secs(5);

/// A connection on which every call carries the token, if there is one.
///
/// A call ends with `DEADLINE_EXCEEDED` when no answer has begun a little after its deadline (`grpc-timeout`, or else
/// five minutes). The transport enforces deadlines too, but not in all of its states: a call on a connection that the
/// coordinator closes in the moment in which it is opened may otherwise wait for ever.
///
/// A call ends with `UNAUTHENTICATED` when the coordinator ends the connection because of the client's certificate, or
/// its absence. The transport may miss that too, so as long as no call was answered on this link, a call that takes
/// long makes a separate handshake to check.
#[derive(Debug, Clone)]
pub struct Link {
    channel: Channel,
    bearer: Bearer,
    /// Finds out why the connection was cut.
    handshake: Option<Handshake>,
    /// Whether any call was answered: then no certificate is the cause of a failure.
    answered: Arc<AtomicBool>,
}

impl Link {
    pub(crate) fn new(channel: Channel, bearer: Bearer, handshake: Option<Handshake>) -> Self {
        Self { channel, bearer, handshake, answered: Arc::default() }
    }
}

/// A link without a token, such as one to a coordinator in the same process.
impl From<Channel> for Link {
    fn from(channel: Channel) -> Self {
        Self::new(channel, Bearer::default(), None)
    }
}

type Answer = Result<http::Response<Body>, tonic::transport::Error>;

impl Service<http::Request<Body>> for Link {
    type Response = http::Response<Body>;
    type Error = tonic::transport::Error;
    type Future = Pin<Box<dyn Future<Output = Answer> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        self.channel.poll_ready(context)
    }

    fn call(&mut self, mut request: http::Request<Body>) -> Self::Future {
        self.bearer.mark(request.headers_mut());
        let deadline = request.headers().get("grpc-timeout").and_then(|value| parse(value.to_str().ok()?));
        let (answer, handshake, answered) =
            (self.channel.call(request), self.handshake.clone(), self.answered.clone());
        let answer = async move {
            let unasked = handshake.as_ref().filter(|_| !answered.load(Ordering::Relaxed));
            let answer = async {
                let answer = answer.await;
                answered.fetch_or(answer.is_ok(), Ordering::Relaxed);
                answer
            };
            match unless_refused(answer, async move { unasked?.refusal().await }).await {
                Err(error) => why_refused(&error, handshake).await.map(Status::into_http).ok_or(error),
                answer => answer,
            }
        };
        Box::pin(in_time(deadline.unwrap_or(DEADLINE) + GRACE, answer))
    }
}

/// An answer, or a refusal that is found while no answer comes.
async fn unless_refused(
    answer: impl Future<Output = Answer>,
    refusal: impl Future<Output = Option<Status>>,
) -> Answer {
    let refused = async {
        tokio::time::sleep(SILENCE).await;
        refusal.await
    };
    tokio::select! {
        biased;
        answer = answer => answer,
        Some(status) = refused => Ok(status.into_http()),
    }
}

/// The reason why the coordinator does not accept the certificate, or its absence; None if the call failed for
/// another reason.
async fn why_refused(error: &tonic::transport::Error, handshake: Option<Handshake>) -> Option<Status> {
    match (refusal(error), handshake) {
        (None, Some(handshake)) if was_cut(error) => handshake.refusal().await,
        (refusal, _) => refusal,
    }
}

/// Whether the error is the end of a connection that was established, or seemed to be.
pub(crate) fn was_cut(error: &tonic::transport::Error) -> bool {
    let mut causes = std::iter::successors(Some(error as &(dyn Error + 'static)), |&cause| cause.source());
    !causes.any(|cause| cause.is::<ConnectError>() || cause.is::<TimeoutExpired>())
}

async fn in_time(limit: Duration, answer: impl Future<Output = Answer>) -> Answer {
    tokio::time::timeout(limit, answer).await.unwrap_or_else(|_| {
        let status = Status::deadline_exceeded(format!("no answer within {} s", limit.as_secs()));
        Ok(status.into_http())
    })
}

/// A `grpc-timeout`: up to eight digits and a unit.
fn parse(timeout: &str) -> Option<Duration> {
    let (digits, unit) = timeout.split_at_checked(timeout.len().checked_sub(1)?)?;
    let number: u64 = digits.parse().ok()?;
    Some(match unit {
        "H" => Duration::from_secs(3600 * number),
        "M" => Duration::from_secs(60 * number),
        "S" => Duration::from_secs(number),
        "m" => Duration::from_millis(number),
        "u" => Duration::from_micros(number),
        "n" => Duration::from_nanos(number),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_are_read_as_tonic_writes_them() {
        for seconds in [0.02, 3.0, 250.0, 7200.0, 2e6] {
            let deadline = Duration::from_secs_f64(seconds);
            let mut request = tonic::Request::new(());
            request.set_timeout(deadline);
            let written = request.metadata().get("grpc-timeout").unwrap().to_str().unwrap();
            assert_eq!(parse(written), Some(deadline), "{written}");
        }
        for wrong in ["", "5", "S", "5 S", "-5S", "5X", "5é"] {
            assert_eq!(parse(wrong), None, "{wrong}");
        }
    }

    /// A call that hangs because the handshake was refused ends with the refusal; one that takes long and is not refused
    /// gets its answer.
    #[tokio::test(start_paused = true)]
    async fn only_refused_calls_end_as_refused() {
        let refusal = |text: &str| Some(Status::unauthenticated(text));
        for (answers, refused_after, refusal, expected) in [
            (u32::MAX, 0, refusal("not your certificate"), tonic::Code::Unauthenticated),
            (2, 0, None, tonic::Code::NotFound),
            (2, 2, refusal("came too late"), tonic::Code::NotFound),
        ] {
            let answer = async {
                tokio::time::sleep(SILENCE * answers).await;
                Ok(Status::not_found("no such dictionary").into_http())
            };
            let refusing = async {
                tokio::time::sleep(SILENCE * refused_after).await;
                refusal.clone()
            };
            let answer = unless_refused(answer, refusing).await.unwrap();
            let status = Status::from_header_map(answer.headers()).unwrap();
            assert_eq!(status.code(), expected, "{refusal:?}");
        }
    }

    /// A call without an answer ends with a status after its time limit.
    #[tokio::test(start_paused = true)]
    async fn unanswered_call_ends_with_a_status() {
        let (start, limit) = (tokio::time::Instant::now(), Duration::from_secs(7));
        let answer = in_time(limit, std::future::pending()).await.unwrap();
        assert_eq!(start.elapsed(), limit);
        let status = Status::from_header_map(answer.headers()).unwrap();
        assert_eq!(
            (status.code(), status.message()),
            (tonic::Code::DeadlineExceeded, "no answer within 7 s")
        );
    }
}
