//! Kills and stops coordinators, and waits for their end.

use std::time::Duration;

use super::Farm;
use crate::process::SOON;

impl Farm {
    /// `kill -9`.
    pub fn kill_coordinator(&mut self) {
        self.coordinator.take().expect("the coordinator runs").kill();
    }

    /// SIGTERM; the exit code.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn stop_coordinator(&mut self) -> i32 {
        self.coordinator.take().expect("the coordinator runs").terminate(Duration::from_secs(10))
    }

    /// Waits until it ends by itself; returns its exit code and log.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn coordinator_ends(&mut self) -> (i32, String) {
        let mut coordinator = self.coordinator.take().expect("the coordinator runs");
        (coordinator.exit_within(SOON), coordinator.log())
    }
}
