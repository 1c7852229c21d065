//! Keeps the table of the leases that this worker holds, and the switches that stop their jobs.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use farm_proto::lease::{HeldLease, LeaseKey};
use optics_model::Digest;

/// Stops the tracing of a set of jobs that share their walks once all of them are stopped.
#[derive(Debug)]
pub(crate) struct SetSwitch {
    going: AtomicUsize,
    pub stop: AtomicBool,
}

impl SetSwitch {
    /// A switch for a set of `jobs`.
    pub(crate) fn new(jobs: usize) -> Arc<Self> {
        Arc::new(Self { going: AtomicUsize::new(jobs), stop: AtomicBool::new(false) })
    }
}

/// State that a job's lease shares with its tracing, which runs on another thread.
#[derive(Debug)]
pub(crate) struct JobSwitches {
    /// Whether the job is stopped, since its result is not needed.
    stop: AtomicBool,
    /// Whether the job is being traced.
    running: AtomicBool,
    set: Arc<SetSwitch>,
}

impl Default for JobSwitches {
    /// The switches of a job that is traced alone.
    fn default() -> Self {
        Self::in_set(SetSwitch::new(1))
    }
}

impl JobSwitches {
    fn in_set(set: Arc<SetSwitch>) -> Self {
        Self { stop: AtomicBool::new(false), running: AtomicBool::new(false), set }
    }

    /// Keeps the job from beginning, or ends it as soon as no other job needs its walks.
    pub(crate) fn stop(&self) {
        if !self.stop.swap(true, Ordering::SeqCst) && self.set.going.fetch_sub(1, Ordering::SeqCst) == 1 {
            self.set.stop.store(true, Ordering::SeqCst);
        }
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    /// The flag that ends the tracing of the set.
    pub(crate) fn all_stopped(&self) -> &AtomicBool {
        &self.set.stop
    }

    pub(crate) fn is_running(&self) -> bool {
        self.running.load(Ordering::SeqCst)
    }

    /// Marks the job as running; false if it was stopped before.
    pub(crate) fn start(&self) -> bool {
        // In this order: a job that is stopped before it is marked as running is certain not to be traced.
        self.running.store(true, Ordering::SeqCst);
        !self.is_stopped()
    }
}

#[derive(Debug)]
struct LeaseEntry {
    switches: Arc<JobSwitches>,
    identity: Digest,
    /// Whether the job has a result, which is delivered even if the lease is lost.
    traced: bool,
}

/// All leases from the moment they are granted until their results are acknowledged.
#[derive(Debug, Default)]
pub(crate) struct HeldLeases(Mutex<HashMap<LeaseKey, LeaseEntry>>);

impl HeldLeases {
    /// Adds the lease of a job of a set.
    pub(crate) fn add(&self, key: LeaseKey, identity: Digest, set: Arc<SetSwitch>) -> Arc<JobSwitches> {
        let switches = Arc::new(JobSwitches::in_set(set));
        self.map().insert(key, LeaseEntry { switches: switches.clone(), identity, traced: false });
        switches
    }

    pub(crate) fn remove(&self, key: &LeaseKey) {
        self.map().remove(key);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.map().is_empty()
    }

    /// Notes that the job has a result.
    pub(crate) fn mark_traced(&self, key: &LeaseKey) {
        if let Some(entry) = self.map().get_mut(key) {
            entry.traced = true;
            entry.switches.running.store(false, Ordering::SeqCst);
        }
    }

    /// All leases, whether each job is being traced, and the identity of each job.
    pub(crate) fn all(&self) -> Vec<HeldLease> {
        let lease = |(key, entry): (&LeaseKey, &LeaseEntry)| HeldLease {
            key: *key,
            running: entry.switches.is_running(),
            identity: entry.identity,
        };
        self.map().iter().map(lease).collect()
    }

    /// Removes a lost lease and stops its job; false if the job has a result or had ended already.
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

    /// Stops the jobs that have not begun and removes their leases, which it returns.
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

    fn map(&self) -> MutexGuard<'_, HashMap<LeaseKey, LeaseEntry>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{hold, job, lease};

    /// Only the job that is being traced is reported as running. A lost lease stops its job and no other; the result of a
    /// finished job may still count.
    #[test]
    fn lost_lease_stops_its_own_job() {
        let held = HeldLeases::default();
        let keys = [0, 1, 2].map(|n| lease(n).key);
        // One waits for a thread, one is being traced, one has its result.
        let switches = hold(&held, [false, true, true]);
        held.mark_traced(&keys[2]);
        let stopped = || [0, 1, 2].map(|n: usize| switches[n].is_stopped());
        let mut all = held.all();
        all.sort_unstable_by_key(|lease| lease.key);
        let identity = job(1).identity();
        let lease = |i: usize, running| HeldLease { key: keys[i], running, identity };
        assert_eq!(all, [lease(0, false), lease(1, true), lease(2, false)]);
        assert!(!held.lose(&keys[2]));
        assert_eq!((held.all().len(), stopped()), (3, [false; 3]));
        assert!(held.lose(&keys[1]));
        assert_eq!(stopped(), [false, true, false]);
        assert_eq!(held.untraced(), [keys[0]]);
        assert!(!held.lose(&keys[1]), "it is lost once");
    }

    /// The walks of a set continue while one of its jobs is not stopped.
    #[test]
    fn set_stops_with_its_last_job() {
        let (held, set) = (HeldLeases::default(), SetSwitch::new(2));
        let keys = [0, 1].map(|n| lease(n).key);
        let switches = keys.map(|key| held.add(key, job(1).identity(), set.clone()));
        assert!(held.lose(&keys[0]));
        switches[0].stop();
        assert!(switches[0].is_stopped() && !set.stop.load(Ordering::SeqCst));
        assert!(held.lose(&keys[1]));
        assert!(set.stop.load(Ordering::SeqCst));
    }
}
