//! Tracks whether the coordinator answers. A change is logged once, however many calls observe it.

use std::sync::{Mutex, PoisonError};

use tokio::sync::watch;
use tokio::time::Instant;
use tonic::{Code, Status};

/// Reachability of the coordinator, from the outcomes of all calls.
#[derive(Debug)]
pub(crate) struct Reachability {
    url: String,
    state: Mutex<CallState>,
    /// Changes when calls that failed may succeed.
    back: watch::Sender<()>,
}

#[derive(Debug, Default)]
struct CallState {
    joined: bool,
    /// Start of the latest call that was answered.
    answered: Option<Instant>,
    /// Time since which no call has been answered.
    lost: Option<Instant>,
}

/// A change that is logged.
#[derive(Debug, PartialEq)]
enum ReachabilityChange {
    NotReached,
    Lost,
    Found { lost: Instant },
}

impl Reachability {
    pub(crate) fn new(url: &str) -> Self {
        Self { url: url.to_owned(), state: Mutex::default(), back: watch::Sender::default() }
    }

    pub(crate) fn url(&self) -> &str {
        &self.url
    }

    /// Changes from now on when calls that failed may succeed: the coordinator is found again, or has registered this
    /// worker again.
    pub(crate) fn back(&self) -> watch::Receiver<()> {
        self.back.subscribe()
    }

    /// Notes that the coordinator has registered this worker again, so that refused calls are repeated at once.
    pub(crate) fn joined_again(&self) {
        self.back.send_replace(());
    }

    /// Logs the first registration.
    pub(crate) fn joined(&self, label: &str, threads: usize) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if !std::mem::replace(&mut state.joined, true) {
            tracing::info!(label, threads, "joined the coordinator at {}", self.url);
        }
    }

    /// Notes how a call ended that began at `began`: with an answer, or with an error.
    pub(crate) fn note(&self, began: Instant, error: Option<&Status>) {
        let unreachable = error.filter(|status| is_silence(status));
        let change = {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            if unreachable.is_some() { state.failed(began, Instant::now()) } else { state.answered(began) }
        };
        let (url, why) = (&self.url, unreachable.map_or("", Status::message));
        match change {
            None => {}
            Some(ReachabilityChange::NotReached) => {
                tracing::warn!("the coordinator at {url} cannot be reached yet ({why}): trying again");
            }
            Some(ReachabilityChange::Lost) => {
                tracing::warn!("lost the coordinator at {url} ({why}): results are kept, trying again");
            }
            Some(ReachabilityChange::Found { lost }) => {
                let away_s = lost.elapsed().as_secs_f64();
                tracing::info!("found the coordinator at {url} again, after {away_s:.1} s");
                self.back.send_replace(());
            }
        }
    }
}

impl CallState {
    /// A call that began before the coordinator was lost is ignored: a stopping coordinator still answers it.
    fn answered(&mut self, began: Instant) -> Option<ReachabilityChange> {
        self.answered = self.answered.max(Some(began));
        let lost = self.lost.take_if(|lost| began >= *lost)?;
        self.joined.then_some(ReachabilityChange::Found { lost })
    }

    /// A call that began before the latest answered one is ignored.
    fn failed(&mut self, began: Instant, now: Instant) -> Option<ReachabilityChange> {
        if self.lost.is_some() || self.answered.is_some_and(|answered| began < answered) {
            return None;
        }
        self.lost = Some(now);
        Some(if self.joined { ReachabilityChange::Lost } else { ReachabilityChange::NotReached })
    }
}

/// Whether a call failed because there was no answer.
pub(crate) fn is_silence(status: &Status) -> bool {
    matches!(status.code(), Code::Unavailable | Code::DeadlineExceeded | Code::Cancelled | Code::Unknown)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Each change of reachability is reported once.
    #[test]
    fn each_change_is_reported_once() {
        let at = {
            let start = Instant::now();
            move |s| start + Duration::from_secs(s)
        };
        let mut state = CallState::default();
        assert_eq!(state.failed(at(0), at(1)), Some(ReachabilityChange::NotReached));
        assert_eq!(state.failed(at(2), at(3)), None);
        assert_eq!(state.answered(at(4)), None, "registration has its own message");
        state.joined = true;
        assert_eq!(state.answered(at(5)), None);
        assert_eq!(state.failed(at(6), at(7)), Some(ReachabilityChange::Lost));
        assert_eq!(state.failed(at(6), at(8)), None);
        assert_eq!(state.answered(at(6)), None, "it began before the coordinator was lost");
        assert_eq!(state.answered(at(9)), Some(ReachabilityChange::Found { lost: at(7) }));
        assert_eq!(state.failed(at(8), at(20)), None, "it began before the coordinator was found again");
        assert_eq!(state.failed(at(21), at(22)), Some(ReachabilityChange::Lost));
    }

    /// A coordinator that answers with an error is reached.
    #[test]
    fn refusing_coordinator_counts_as_reached() {
        assert!(is_silence(&Status::unavailable("")));
        for answer in [Status::internal(""), Status::aborted(""), Status::permission_denied("")] {
            assert!(!is_silence(&answer), "{answer}");
        }
    }
}
