//! Tests the leases of parts: their holders and their ends.

use farm_proto::lease::{HeldLease, Lease};
use farm_proto::status::DictionaryState;

use super::{Bench, DIGEST, FIRST, about, seconds, worker};
use crate::dispatch::{Admission, DispatchError, Registration};
use crate::stored::{DesiredState, Machine, Origin};

/// The late result of the first worker still counts, and the second result is compared with it.
#[test]
fn expired_lease_goes_to_another_worker() {
    let mut bench = Bench::new(&[]);
    let old = bench.acquire(0, "a", 1);
    assert_eq!(bench.farm.look_over(seconds(29)), 0);
    assert_eq!(bench.farm.look_over(seconds(30)), 1);
    let new = bench.acquire(31, "b", 1);
    assert_eq!((new[0].key.job, new[0].key.attempt), (old[0].key.job, 2));
    assert!(!bench.renew(32, "a", &old[0], true), "the lease is lost");
    assert!(matches!(bench.admit("a", &old[0]), Ok(Admission::Store { .. })), "but its result is as good");
    bench.finish(33, "a", &old[0]);
    assert!(!bench.renew(34, "b", &new[0], true), "now no worker holds it");
    assert!(matches!(bench.admit("b", &new[0]), Ok(Admission::Compare { stored: DIGEST, .. })));
}

/// After the coordinator was held up, leases last as long as after a renewal, also those that were granted or renewed
/// before the first look.
#[test]
fn held_up_coordinator_prolongs_no_new_lease() {
    let mut bench = Bench::new(&[]);
    let old = bench.acquire(0, "a", 1);
    let renewed = bench.acquire(0, "b", 1);
    bench.farm.look_over(seconds(1));
    assert!(bench.renew(1000, "b", &renewed[0], true));
    let new = bench.acquire(1000, "c", 1);
    assert_eq!(bench.farm.look_over(seconds(1001)), 0, "a's lease has 29 s left, as before");
    bench.farm.check(seconds(1001)).unwrap();
    let since = |lease: &Lease| bench.farm.schedule.leases().get(&lease.key).unwrap().since;
    assert_eq!([&old[0], &new[0]].map(since), [seconds(1000), seconds(1001)]);
    assert_eq!(bench.look(1002..1030), 0);
    assert_eq!(bench.farm.look_over(seconds(1030)), 1);
    assert_eq!(bench.farm.look_over(seconds(1031)), 2, "no worker has renewed its lease");
}

/// After a restart a worker keeps a lease only of the job that it computes, and of a dictionary that is not paused.
#[test]
fn renewals_after_a_restart_are_checked() {
    let lease = Bench::new(&[]).one(0, "a");
    let mut after = Bench::new(&[]);
    let lost_keys = |after: &mut Bench, name| {
        let held = vec![HeldLease { key: lease.key, running: true, identity: DIGEST }];
        after.farm.renew(seconds(0), &worker(name), held).unwrap().0
    };
    assert_eq!(lost_keys(&mut after, "a"), [lease.key]);
    after.desire(FIRST, DesiredState::Pause);
    assert!(!after.renew(0, "a", &lease, true), "nothing is computed for it now");
    after.desire(FIRST, DesiredState::Run);
    assert!(after.renew(0, "a", &lease, true), "the part waits: it is the worker's again");
    assert!(!after.jobs(1, "b", 9).contains(&lease.key.job));
    assert_eq!(lost_keys(&mut after, "b"), [lease.key]);
}

/// After a restart a lease is taken up again only with the access token of its holder.
#[test]
fn restart_keeps_leases_to_their_tokens() {
    let with_token = |token: &str| {
        let mut bench = Bench::new(&[]);
        let machine = Machine { token: token.to_owned(), ..Machine::at("d") };
        bench.register(0, "d", Origin(4), Registration { machine, ..about("d") }).unwrap();
        bench
    };
    let lease = with_token("t").acquire(0, "d", 1);
    assert!(!with_token("u").renew(0, "d", &lease[0], true));
    assert!(with_token("t").renew(0, "d", &lease[0], true));
}

/// A worker that leaves frees all its leases, including those whose grant it has not received, and is then unknown.
#[test]
fn leaving_worker_frees_all_its_leases() {
    let mut bench = Bench::new(&[]);
    bench.acquire(0, "a", 2);
    bench.leave(&["a"]);
    assert_eq!(bench.acquire(1, "b", 10).len(), 3);
    let late = bench.farm.acquire(seconds(2), &worker("a"), 1, &mut bench.chance);
    assert_eq!(late.unwrap_err(), DispatchError::UnknownWorker(worker("a")));
}

/// A late job is leased to a second worker, and the first result counts.
#[test]
fn straggler_gets_a_second_copy() {
    let (mut bench, left) = Bench::with_one_left();
    bench.farm.look_over(seconds(4));
    assert!(bench.acquire(4, "b", 1).is_empty(), "not yet");
    bench.look_at(&[9, 14, 18]);
    assert!(bench.acquire(18, "a", 1).is_empty(), "not a second copy for the same worker");
    let copy = bench.acquire(18, "b", 1);
    assert_eq!(copy[0].key.job, left.key.job);
    bench.farm.look_over(seconds(19));
    assert!(bench.acquire(19, "c", 1).is_empty(), "two are enough");
    bench.finish(20, "b", &copy[0]);
    assert_eq!(bench.state(), DictionaryState::Done);
    assert!(!bench.renew(20, "a", &left, true), "the slow one is stopped");
}

/// Results of leases from before the pause are stored. No lease is granted, not even for a second copy.
#[test]
fn paused_dictionary_only_finishes_its_leases() {
    let (mut bench, left) = Bench::with_one_left();
    bench.look(4..21);
    bench.desire(FIRST, DesiredState::Pause);
    assert!(bench.acquire(20, "b", 9).is_empty(), "no second copy either");
    assert!(matches!(bench.admit("a", &left), Ok(Admission::Store { .. })));
}
