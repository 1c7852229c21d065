//! The leases that this worker holds.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use farm_proto::lease::LeaseKey;
use optics_model::Digest;

/// Switches between a job's lease and its tracing.
#[derive(Debug, Default)]
pub(crate) struct Switches {
    /// Ends the tracing, or keeps it from beginning.
    pub stop: AtomicBool,
    /// It is being traced.
    pub running: AtomicBool,
}

impl Switches {
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    pub(crate) fn is_running(&self) -> bool {
        self.running.load(Ordering::Relaxed)
    }
}

#[derive(Debug)]
struct Entry {
    switches: Arc<Switches>,
    identity: Digest,
    /// Its result waits to be delivered, which it is also if the lease is lost.
    traced: bool,
}

#[derive(Debug, Default)]
pub(crate) struct Held(Mutex<HashMap<LeaseKey, Entry>>);

impl Held {
    pub(crate) fn add(&self, key: LeaseKey, identity: Digest) -> Arc<Switches> {
        let switches = Arc::new(Switches::default());
        self.map().insert(key, Entry { switches: switches.clone(), identity, traced: false });
        switches
    }

    pub(crate) fn remove(&self, key: &LeaseKey) {
        self.map().remove(key);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.map().is_empty()
    }

    /// The job has its result.
    pub(crate) fn traced(&self, key: &LeaseKey) {
        if let Some(entry) = self.map().get_mut(key) {
            entry.traced = true;
            entry.switches.running.store(false, Ordering::Relaxed);
        }
    }

    /// All leases, whether each is being traced, and what its records depend on.
    pub(crate) fn all(&self) -> Vec<(LeaseKey, bool, Digest)> {
        self.map().iter().map(|(key, e)| (*key, e.switches.is_running(), e.identity)).collect()
    }

    /// Forgets a lease that is lost and stops its job; false if it has its result or had ended already.
    pub(crate) fn lose(&self, key: &LeaseKey) -> bool {
        let mut map = self.map();
        if map.get(key).is_none_or(|e| e.traced) {
            return false;
        }
        if let Some(entry) = map.remove(key) {
            entry.switches.stop();
        }
        true
    }

    /// Stops the jobs that are not being traced yet, and forgets them: their leases.
    pub(crate) fn give_up_waiting(&self) -> Vec<LeaseKey> {
        let mut given_up = Vec::new();
        self.map().retain(|key, entry| {
            let waits = !entry.traced && !entry.switches.is_running();
            if waits {
                entry.switches.stop();
                given_up.push(*key);
            }
            !waits
        });
        given_up
    }

    pub(crate) fn stop_all(&self) {
        for entry in self.map().values() {
            entry.switches.stop();
        }
    }

    /// Leases of jobs without a result.
    pub(crate) fn untraced(&self) -> Vec<LeaseKey> {
        self.map().iter().filter(|(_, e)| !e.traced).map(|(key, _)| *key).collect()
    }

    fn map(&self) -> MutexGuard<'_, HashMap<LeaseKey, Entry>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
