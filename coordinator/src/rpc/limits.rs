//! The quotas of calls: cores for fits, streams, and registrations of workers.

use std::sync::Arc;

use tonic::Status;

use crate::quota::{Held, Limit, Quota};
use crate::stored::Machine;

/// Largest number of fits that wait for a core, in addition to those that have one, and of those of one token.
const WAITING: u64 = 256;
const WAITING_OF_ONE: u64 = 64;
/// Largest number of streams that are watched or exported, and of those of one token, so that others can open some, too.
const STREAMS: u64 = 1024;
const STREAMS_OF_ONE: u64 = 256;
/// Workers that one machine may register at once, and in each second after that. Each registration is written to the disk.
const REGISTRATIONS: u64 = 1000;
const REGISTRATIONS_IN_A_SECOND: f64 = 10.0;

/// Limits that all calls share. Those of one token are for callers that share under this name, which is empty for those
/// without a share.
#[derive(Debug, Clone)]
pub(super) struct Limits {
    cores: Arc<Quota>,
    /// Number of cores.
    most: u64,
    waiting: Arc<Quota>,
    streams: Arc<Quota>,
    registrations: Arc<Quota>,
}

impl Default for Limits {
    fn default() -> Self {
        let again = "try again later";
        Self {
            cores: Quota::new("cores", again),
            most: std::thread::available_parallelism().map_or(1, usize::from) as u64,
            waiting: Quota::new("waiting fits", again),
            streams: Quota::new("open streams", "end some"),
            registrations: Quota::refilled(REGISTRATIONS_IN_A_SECOND, "registrations at once", again),
        }
    }
}

impl Limits {
    /// Waits for a core for a fit; refused if too many wait. One token leaves a core to others, if there are several.
    pub(super) async fn fit(&self, caller: &str) -> Result<Held, Status> {
        let _waits = self.waiting.hold(Limit::shared(caller, WAITING_OF_ONE, WAITING), 1)?;
        let own = self.most.saturating_sub(1).max(1);
        Ok(self.cores.wait(Limit::shared(caller, own, self.most), 1).await)
    }

    /// A place for a stream; refused if there are too many.
    pub(super) fn stream(&self, caller: &str) -> Result<Held, Status> {
        Ok(self.streams.hold(Limit::shared(caller, STREAMS_OF_ONE, STREAMS), 1)?)
    }

    /// Counts the registration of a worker.
    pub(super) fn register(&self, machine: &Machine) -> Result<(), Status> {
        Ok(self.registrations.spend(&[Limit::new(machine.identity(), REGISTRATIONS)], 1)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One token leaves streams, cores and places to others.
    #[tokio::test]
    async fn one_token_leaves_calls_for_others() {
        let limits = Limits { most: 2, ..Limits::default() };
        let of_bob: Vec<_> = (0..STREAMS_OF_ONE).map(|_| limits.stream("bob").unwrap()).collect();
        let refused = limits.stream("bob").unwrap_err();
        assert_eq!(refused.message(), "256 open streams are allowed for bob, of which 0 are left: end some");
        let _of_alice = limits.stream("alice").unwrap();
        drop(of_bob);
        let _of_admins: Vec<_> = (1..STREAMS).map(|_| limits.stream("").unwrap()).collect();
        assert!(limits.stream("alice").unwrap_err().message().contains("allowed for all callers"));

        let _core = limits.fit("bob").await.unwrap();
        let waits = || {
            let limits = limits.clone();
            tokio::spawn(async move { limits.fit("bob").await })
        };
        let waiting: Vec<_> = (0..WAITING_OF_ONE).map(|_| waits()).collect();
        // The runtime comes back to this task before it has run all of these.
        for _ in 0..WAITING_OF_ONE {
            tokio::task::yield_now().await;
        }
        assert!(
            limits.fit("bob").await.unwrap_err().message().contains("64 waiting fits are allowed for bob")
        );
        let _other = limits.fit("alice").await.unwrap();
        assert!(waiting.iter().all(|fit| !fit.is_finished()));
    }

    /// One machine registers a thousand workers at once, and few after that; others are not affected.
    #[tokio::test(start_paused = true)]
    async fn registrations_of_a_machine_are_limited() {
        let limits = Limits::default();
        let [mallory, alice] = ["10.0.0.1", "10.0.0.2"].map(Machine::at);
        let registered = |machine| (0..7000).filter(|_| limits.register(machine).is_ok()).count() as u64;
        assert_eq!(registered(&mallory), REGISTRATIONS);
        assert_eq!(registered(&alice), REGISTRATIONS);
        tokio::time::advance(std::time::Duration::from_secs(20)).await;
        assert_eq!(registered(&mallory), 200);
    }
}
