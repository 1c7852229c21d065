//! Measures how long the worker has been without work, for workers that end after a time limit.

use std::time::Duration;

use tokio::time::Instant;

/// Longest time that one call waits for work.
const WAIT: Duration = Duration::from_secs(20);

/// Idle time, compared with its limit.
#[derive(Debug)]
pub(crate) struct IdleTime {
    limit: Option<Duration>,
    since: Instant,
}

impl IdleTime {
    pub(crate) fn new(limit: Option<Duration>) -> Self {
        Self { limit, since: Instant::now() }
    }

    /// Restarts the measurement: there is work now.
    pub(crate) fn reset(&mut self) {
        self.since = Instant::now();
    }

    /// Time for which the next call may wait for work.
    pub(crate) fn wait(&self) -> Duration {
        self.limit.map_or(WAIT, |limit| limit.saturating_sub(self.since.elapsed()).min(WAIT))
    }

    pub(crate) fn is_over(&self) -> bool {
        self.limit.is_some_and(|limit| self.since.elapsed() >= limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The idle limit is reached by waiting for the returned times.
    #[tokio::test(start_paused = true)]
    async fn idle_limit_is_reached_by_waiting() {
        let mut idle = IdleTime::new(Some(Duration::from_secs(50)));
        for (wait_s, over) in [(20, false), (20, false), (10, true), (0, true)] {
            assert_eq!(idle.wait(), Duration::from_secs(wait_s));
            tokio::time::advance(idle.wait()).await;
            assert_eq!(idle.is_over(), over);
        }
        idle.reset();
        assert!(!idle.is_over());
        assert_eq!(idle.wait(), WAIT);
    }
}
