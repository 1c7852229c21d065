//! Repeats failed calls after pauses that double. A pause is cut short when the coordinator answers again.

use std::time::Duration;

use farm_link::is_passing;
use tokio::sync::watch;
use tonic::{Code, Status};

use crate::reachability::is_silence;

/// First and longest pause before a call is repeated.
const PAUSE: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(10));

/// At most this many pauses are cut short between two resets, so that a coordinator that answers but keeps failing is
/// not called too often.
const EARLY: u32 = 3;

/// Pauses that double with each consecutive failure.
#[derive(Debug)]
pub(crate) struct Pauses {
    first: Duration,
    longest: Duration,
    next: Duration,
    /// Number of pauses that were cut short since the last reset.
    early: u32,
}

impl Pauses {
    pub(crate) fn new(first: Duration, longest: Duration) -> Self {
        Self { first, longest, next: first, early: 0 }
    }

    /// Begins with the first pause again.
    pub(crate) fn reset(&mut self) {
        (self.next, self.early) = (self.first, 0);
    }

    /// Between half and all of the next pause, so that workers do not return at the same moment.
    fn next(&mut self) -> Duration {
        let pause = self.next;
        self.next = (2 * pause).min(self.longest);
        let mut byte = [0_u8];
        // Without randomness the pauses are not spread.
        let _ = getrandom::fill(&mut byte);
        pause.mul_f64(0.5 + f64::from(byte[0]) / 512.0)
    }

    /// Waits until the next pause is over or the coordinator is back.
    pub(crate) async fn wait(&mut self, back: &mut watch::Receiver<()>) {
        let pause = self.next();
        self.wait_for(pause, back).await;
    }

    async fn wait_for(&mut self, pause: Duration, back: &mut watch::Receiver<()>) {
        let is_back = async {
            // The session has ended, so no change will come: the pause has its full length.
            if self.early >= EARLY || back.changed().await.is_err() {
                std::future::pending::<()>().await;
            }
        };
        if tokio::time::timeout(pause, is_back).await.is_ok() {
            self.early += 1;
        }
    }
}

/// Repeats a call while it fails with a transient error, with growing pauses of random length. All pauses end when the
/// coordinator is back, so that results are delivered before their jobs are leased to other workers.
pub(crate) async fn repeat<T, F: Future<Output = Result<T, Status>>>(
    mut back: watch::Receiver<()>,
    mut call: impl FnMut() -> F,
) -> Result<T, Status> {
    let mut pauses = Pauses::new(PAUSE.0, PAUSE.1);
    loop {
        match call().await {
            Err(status) if is_passing(&status) => {
                let pause = pauses.next();
                log_failure(&status, &format!("the call is repeated in {pause:.1?}"));
                pauses.wait_for(pause, &mut back).await;
            }
            answer => return answer,
        }
    }
}

/// Whether the coordinator refuses this worker for good.
pub(crate) fn is_refusal(status: &Status) -> bool {
    matches!(status.code(), Code::Unauthenticated | Code::PermissionDenied | Code::FailedPrecondition)
}

/// Logs that a call failed. Silence of the coordinator and a lost registration are logged elsewhere, once instead of
/// per call.
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

    /// The final code of `repeat` if calls get these answers in turn, and the number of calls.
    async fn repeated(codes: &[Code]) -> (Code, usize) {
        let calls = RefCell::new(codes.iter());
        let (_never, back) = watch::channel(());
        let answer = repeat(back, || async {
            match calls.borrow_mut().next() {
                Some(&Code::Ok) | None => Ok(()),
                Some(&code) => Err(Status::new(code, "")),
            }
        });
        let code = answer.await.map_or_else(|status| status.code(), |()| Code::Ok);
        (code, codes.len() - calls.borrow().len())
    }

    /// Transient errors are retried, and others end the call.
    #[tokio::test(start_paused = true)]
    async fn transient_errors_are_retried() {
        use Code::*;
        let passing = [Unavailable, DeadlineExceeded, Aborted, Internal, Unknown, Code::Ok];
        assert_eq!(repeated(&passing).await, (Code::Ok, 6));
        for code in [InvalidArgument, FailedPrecondition, PermissionDenied, NotFound] {
            assert_eq!(repeated(&[Code::Unavailable, code, Code::Ok]).await, (code, 2));
        }
    }

    /// In an hour without an answer, a call is repeated at least every 20 s, and fewer than 1,000 times; by a coordinator
    /// that returns again and again and refuses, about ten times a minute.
    #[tokio::test(start_paused = true)]
    async fn calls_repeat_with_pauses() {
        for (returns, status, count) in
            [(false, Status::unavailable(""), 180..1000), (true, Status::aborted(""), 360..900)]
        {
            let (start, calls) = (Instant::now(), RefCell::new(Vec::new()));
            let (sender, back) = watch::channel(());
            let answer = repeat(back, || async {
                calls.borrow_mut().push(start.elapsed());
                if returns {
                    sender.send_replace(());
                }
                if start.elapsed() < Duration::from_hours(1) { Err(status.clone()) } else { Ok(()) }
            });
            answer.await.unwrap();
            let calls = calls.into_inner();
            let longest = calls.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).max().unwrap();
            assert!(longest <= Duration::from_secs(20), "{returns}: {longest:?}");
            assert!(count.contains(&calls.len()), "{returns}: {} calls", calls.len());
        }
    }

    /// Notified during a call that then fails: the next call follows at once, later ones after pauses.
    #[tokio::test(start_paused = true)]
    async fn notice_during_a_call_counts_once() {
        let (sender, back) = watch::channel(());
        let calls = RefCell::new(Vec::new());
        let answer = repeat(back, || async {
            calls.borrow_mut().push(Instant::now());
            if calls.borrow().len() == 1 {
                sender.send_replace(());
            }
            if calls.borrow().len() < 4 { Err(Status::aborted("")) } else { Ok(()) }
        });
        answer.await.unwrap();
        let pauses: Vec<Duration> = calls.borrow().windows(2).map(|pair| pair[1] - pair[0]).collect();
        let few = Duration::from_millis(10);
        assert!(pauses[0] < few && pauses[1] > few && pauses[2] > few, "{pauses:?}");
    }

    /// Pauses grow up to the longest, and start again from the shortest.
    #[tokio::test(start_paused = true)]
    async fn pauses_grow_to_a_limit_and_reset() {
        let mut pauses = Pauses::new(Duration::from_secs(1), Duration::from_secs(4));
        let (_never, mut back) = watch::channel(());
        for expected_s in [1, 2, 4, 4] {
            let start = Instant::now();
            pauses.wait(&mut back).await;
            let (pause, expected) = (start.elapsed(), Duration::from_secs(expected_s));
            let rounding = Duration::from_millis(1);
            assert!(pause >= expected / 2 && pause <= expected + rounding, "{pause:?} of {expected:?}");
        }
        pauses.reset();
        let start = Instant::now();
        pauses.wait(&mut back).await;
        assert!(start.elapsed() <= Duration::from_millis(1001));
    }
}
