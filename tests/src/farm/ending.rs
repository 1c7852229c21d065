//! Kills and stops coordinators, and waits for their end.

use std::time::Duration;

use super::Farm;
use crate::process::SOON;

impl Farm {
    /// Sends SIGKILL to the coordinator, and waits until it is gone.
    pub fn kill_coordinator(&mut self) {
        self.coordinator.take().expect("the coordinator runs").kill();
    }

    /// Sends SIGTERM to the coordinator; returns the exit code.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn stop_coordinator(&mut self) -> i32 {
        self.coordinator.take().expect("the coordinator runs").terminate(Duration::from_secs(10))
    }

    /// Waits until the coordinator ends by itself; returns its exit code and log.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn coordinator_ends(&mut self) -> (i32, String) {
        let mut coordinator = self.coordinator.take().expect("the coordinator runs");
        (coordinator.exit_within(SOON), coordinator.log())
    }
}
