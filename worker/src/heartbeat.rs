//! Keeps leases alive while their jobs are traced, and stops those that are lost.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use farm_proto::job::LeaseKey;
use tokio_util::sync::CancellationToken;

use crate::session::Session;

/// The leases that this worker holds, each with the switch that stops its job.
#[derive(Debug, Default)]
pub(crate) struct Held(Mutex<HashMap<LeaseKey, Arc<AtomicBool>>>);

impl Held {
    pub(crate) fn add(&self, key: LeaseKey) -> Arc<AtomicBool> {
        let stop = Arc::new(AtomicBool::new(false));
        self.map().insert(key, stop.clone());
        stop
    }

    pub(crate) fn remove(&self, key: &LeaseKey) {
        self.map().remove(key);
    }

    pub(crate) fn keys(&self) -> Vec<LeaseKey> {
        self.map().keys().cloned().collect()
    }

    /// Forgets a lease that is lost and stops its job; false if it had ended already.
    pub(crate) fn lose(&self, key: &LeaseKey) -> bool {
        let stop = self.map().remove(key);
        if let Some(stop) = &stop {
            stop.store(true, Ordering::Relaxed);
        }
        stop.is_some()
    }

    pub(crate) fn stop_all(&self) {
        for stop in self.map().values() {
            stop.store(true, Ordering::Relaxed);
        }
    }

    fn map(&self) -> MutexGuard<'_, HashMap<LeaseKey, Arc<AtomicBool>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Renews four times per lease until `end`.
pub(crate) async fn beat(session: Arc<Session>, held: Arc<Held>, end: CancellationToken) {
    let mut tick = tokio::time::interval((session.lease() / 4).max(Duration::from_millis(50)));
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = end.cancelled() => return,
            _ = tick.tick() => {}
        }
        let renewed = tokio::select! {
            () = end.cancelled() => return,
            renewed = session.renew(held.keys()) => renewed,
        };
        match renewed {
            Ok(lost) => {
                for key in lost.into_iter().filter(|key| held.lose(key)) {
                    tracing::warn!(job = key.job, attempt = key.attempt, "lease lost: its job is dropped");
                }
            }
            Err(status) => tracing::warn!(code = ?status.code(), message = status.message(), "no heartbeat"),
        }
    }
}
