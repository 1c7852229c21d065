//! Tests which transitions wake waiting workers and watching clients, and which are counted.

use super::Bench;
use crate::dispatch::{Count, Purpose};

/// A lease is reported as a change, and counted as the first of its part or as a retry. A result counts as a job.
#[test]
fn granted_leases_are_counted_by_purpose() {
    let mut bench = Bench::new(&[]);
    bench.farm.take_outbox();
    for (at, purpose) in [(0, Purpose::First), (1, Purpose::Retry)] {
        let lease = bench.one(at, "a");
        let outbox = bench.farm.take_outbox();
        assert!(outbox.changed && outbox.counts == [Count::Granted(purpose)], "{outbox:?}");
        bench.farm.hand_back(&[lease.key]);
        bench.farm.take_outbox();
    }
    let lease = bench.one(2, "a");
    bench.finish(3, "a", &lease);
    assert_eq!(bench.farm.schedule.jobs_done(), 1);
}

/// A worker that waits for work is woken when it is to leave, or when a part is late.
#[test]
fn drains_and_late_parts_wake_workers() {
    let (mut bench, _) = Bench::with_one_left();
    bench.farm.take_outbox();
    let mut woken = [4, 9, 14, 18].map(|second| {
        bench.look_at(&[second]);
        bench.farm.take_outbox().work
    });
    woken.sort_unstable();
    assert_eq!((woken[0], woken[3]), (false, true), "not at once, and in the end");
    bench.farm.drain("b").unwrap();
    assert!(bench.farm.take_outbox().work);
}
