//! Which failed calls are made again, and when.

use std::time::Duration;

use backon::{ExponentialBuilder, Retryable};
use tonic::{Code, Status};

use crate::reachability::is_silence;

/// A pause that doubles with every failure in a row.
#[derive(Debug)]
pub(crate) struct Pauses {
    first: Duration,
    longest: Duration,
    next: Duration,
}

impl Pauses {
    pub(crate) fn new(first: Duration, longest: Duration) -> Self {
        Self { first, longest, next: first }
    }

    /// The next failure will be the first in a row.
    pub(crate) fn reset(&mut self) {
        self.next = self.first;
    }

    /// Waits for half to the whole of the next pause, so that workers do not come back all at once.
    pub(crate) async fn wait(&mut self) {
        let pause = self.next;
        self.next = (2 * pause).min(self.longest);
        let mut byte = [0_u8];
        // Without randomness the pauses are all the same.
        let _ = getrandom::fill(&mut byte);
        tokio::time::sleep(pause.mul_f64(0.5 + f64::from(byte[0]) / 512.0)).await;
    }
}

/// Calls until the answer is something other than a passing fault, with growing pauses of random length.
pub(crate) async fn repeat<T, F: Future<Output = Result<T, Status>>>(
    call: impl FnMut() -> F,
) -> Result<T, Status> {
    let pauses = ExponentialBuilder::default()
        .with_min_delay(Duration::from_millis(100))
        .with_max_delay(Duration::from_secs(10))
        .with_jitter()
        .without_max_times();
    call.retry(pauses)
        .when(is_passing)
        .notify(|status, pause| {
            log_failure(status, &format!("the call is repeated in {pause:.1?}"));
        })
        .await
}

/// Whether the same call may succeed later.
fn is_passing(status: &Status) -> bool {
    matches!(
        status.code(),
        Code::Unavailable
            | Code::DeadlineExceeded
            | Code::Aborted
            | Code::Cancelled
            | Code::Internal
            | Code::ResourceExhausted
            | Code::Unknown
    )
}

/// Whether the coordinator does not want this worker, now or later.
pub(crate) fn is_refusal(status: &Status) -> bool {
    matches!(status.code(), Code::Unauthenticated | Code::PermissionDenied | Code::FailedPrecondition)
}

/// Logs that a call failed. That the coordinator does not answer, or does not know this worker any more, is logged
/// elsewhere, once and not for each call.
pub(crate) fn log_failure(status: &Status, what: &str) {
    let (code, message) = (status.code(), status.message());
    if is_silence(status) || status.code() == Code::Aborted {
        tracing::debug!(?code, message, "{what}");
    } else {
        tracing::warn!(?code, message, "{what}");
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use tokio::time::Instant;

    use super::*;

    /// The code of the answer of `repeat`, if calls are answered in turn, and how many calls there were.
    async fn repeated(codes: &[Code]) -> (Code, usize) {
        let calls = RefCell::new(codes.iter());
        let answer = repeat(|| async {
            match calls.borrow_mut().next() {
                Some(&Code::Ok) | None => Ok(()),
                Some(&code) => Err(Status::new(code, "")),
            }
        });
        let code = answer.await.map_or_else(|status| status.code(), |()| Code::Ok);
        (code, codes.len() - calls.borrow().len())
    }

    #[tokio::test(start_paused = true)]
    async fn passing_faults_are_repeated_and_others_end_the_call() {
        let passing =
            [Code::Unavailable, Code::DeadlineExceeded, Code::Aborted, Code::Internal, Code::Unknown];
        assert_eq!(repeated(&[passing.as_slice(), &[Code::Ok]].concat()).await, (Code::Ok, 6));
        for code in [Code::InvalidArgument, Code::FailedPrecondition, Code::PermissionDenied, Code::NotFound]
        {
            assert_eq!(repeated(&[Code::Unavailable, code, Code::Ok]).await, (code, 2));
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_hour_of_silence_is_outlasted_with_a_call_at_least_every_twenty_seconds() {
        let (start, calls) = (Instant::now(), RefCell::new(Vec::new()));
        let hour = Duration::from_hours(1);
        let answer = repeat(|| async {
            calls.borrow_mut().push(start.elapsed());
            if start.elapsed() < hour { Err(Status::unavailable("")) } else { Ok(()) }
        });
        answer.await.unwrap();
        let calls = calls.into_inner();
        let longest = calls.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).max().unwrap();
        assert!(longest <= Duration::from_secs(20), "{longest:?}");
        assert!(calls.len() < 1000, "{} calls are a burden", calls.len());
    }

    #[tokio::test(start_paused = true)]
    async fn pauses_grow_up_to_the_longest_and_start_again() {
        let mut pauses = Pauses::new(Duration::from_secs(1), Duration::from_secs(4));
        for expected_s in [1, 2, 4, 4] {
            let start = Instant::now();
            pauses.wait().await;
            let (pause, expected) = (start.elapsed(), Duration::from_secs(expected_s));
            let rounding = Duration::from_millis(1);
            assert!(pause >= expected / 2 && pause <= expected + rounding, "{pause:?} of {expected:?}");
        }
        pauses.reset();
        let start = Instant::now();
        pauses.wait().await;
        assert!(start.elapsed() <= Duration::from_millis(1001));
    }
}
