//! Limits how often warnings are logged that outsiders can cause at will, so that they do not fill the log.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Counts events, and returns their number at intervals, to be logged.
#[derive(Debug)]
pub(crate) struct Throttle {
    every: Duration,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    last_report: Option<Duration>,
    untold: u64,
}

impl Throttle {
    pub(crate) fn new(every: Duration) -> Self {
        Self { every, state: Mutex::default() }
    }

    /// Counts an event at the time `now`. Returns the number since the last report, if that is long enough ago.
    pub(crate) fn count(&self, now: Duration) -> Option<u64> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.untold += 1;
        if state.last_report.is_some_and(|last_report| now.saturating_sub(last_report) < self.every) {
            return None;
        }
        state.last_report = Some(now);
        Some(std::mem::take(&mut state.untold))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first message is logged at once; repetitions within the interval are counted and reported together.
    #[test]
    fn repeated_messages_are_counted_together() {
        let muffle = Throttle::new(Duration::from_secs(10));
        let at = |seconds| muffle.count(Duration::from_secs(seconds));
        assert_eq!(
            [at(5), at(5), at(14), at(15), at(16), at(99)],
            [Some(1), None, None, Some(3), None, Some(2)]
        );
    }
}
