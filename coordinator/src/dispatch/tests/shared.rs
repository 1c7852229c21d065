//! Tests dictionaries with the same walks, whose records are shared.

use farm_proto::ids::DictionaryId;
use farm_proto::lease::Lease;
use optics_model::{Digest, Walks};

use super::{Bench, DIGEST, FIRST, SECOND, origin, seconds};
use crate::stored::DesiredState;
use crate::testing::grid;

/// The bench's dictionary of three points, and a second one with two of these and another between them.
fn overlapping(albedo: &[f64], check_share: f64) -> Bench {
    let mut bench = Bench::with_checks(&[], check_share);
    bench.add(SECOND, grid(None, &[2.0, 15.0, 30.0], albedo, Walks::PAPER.get()), &[]);
    bench
}

fn places(leases: &[Lease]) -> Vec<(DictionaryId, u32)> {
    leases.iter().map(|lease| (lease.key.dictionary, lease.key.job)).collect()
}

/// One of two dictionaries with the same walks computes them, and its records serve both.
#[test]
fn shared_walks_are_computed_once() {
    let mut bench = overlapping(&[0.9], 0.0);
    let leases = bench.acquire(0, "a", 9);
    assert_eq!(places(&leases), [(FIRST, 2), (FIRST, 1), (FIRST, 0), (SECOND, 1)]);
    assert_eq!(bench.farm.schedule.served_by((FIRST, 2)), [(SECOND, 2)]);
    assert!(bench.farm.schedule.done_elsewhere(SECOND).is_empty());
    bench.finish(1, "a", &leases[0]);
    assert_eq!(bench.farm.schedule.done_elsewhere(SECOND), [2]);
    bench.farm.taken_over((SECOND, 2), Walks::PAPER, DIGEST, None);
    assert!(bench.farm.schedule.done_elsewhere(SECOND).is_empty());
    assert_eq!(bench.farm.schedule.by_id(SECOND).unwrap().ended(), (1, 0));
    assert!(bench.farm.schedule.served_by((FIRST, 2)).is_empty());
}

/// A job with more albedos is leased first, regardless of priorities; that another waits for it is explained. Jobs with the
/// same walks but different albedos are both leased.
#[test]
fn most_albedos_go_first() {
    let mut bench = overlapping(&[0.5, 0.9, 0.95], 0.0);
    bench.farm.set_priority(FIRST, 5);
    let leases = bench.acquire(0, "a", 9);
    assert_eq!(places(&leases), [(SECOND, 2), (SECOND, 0), (FIRST, 0), (SECOND, 1)]);
    assert!(bench.reasons(0).contains(&"SHARED"), "{:?}", bench.reasons(0));
    assert_eq!(overlapping(&[0.9, 0.95], 0.0).acquire(0, "a", 9).len(), 6);
}

/// The second dictionary computes the shared walks when the first is paused, cancelled or deleted, or gives up the job.
#[test]
fn stopped_shared_walks_are_taken_over() {
    for how in 0..4 {
        let mut bench = overlapping(&[0.9], 0.0);
        let held = bench.acquire(0, "a", 9);
        assert!(bench.acquire(1, "b", 9).is_empty());
        match how {
            0 => bench.desire(FIRST, DesiredState::Pause),
            1 => bench.desire(FIRST, DesiredState::Cancel),
            2 => bench.farm.remove_dictionary(FIRST),
            _ => {
                bench.fail(1, "a", &held[0]);
                let again = bench.acquire(2, "b", 1);
                assert_eq!(places(&again), [(FIRST, 2)], "tried again for both");
                bench.fail(3, "b", &again[0]);
            }
        }
        let leases = bench.acquire(4, "c", 9);
        let own = if how == 3 { vec![(SECOND, 2)] } else { vec![(SECOND, 2), (SECOND, 0)] };
        assert_eq!(places(&leases), own, "{how}");
    }
}

/// The check of a removed dictionary continues in another one that has the records: otherwise they would never be checked.
#[test]
fn check_outlives_its_dictionary() {
    for (albedo, of_heir) in [(&[0.5, 0.9][..], DIGEST), (&[0.9], Digest::from_bytes([8; 32]))] {
        let mut bench = overlapping(albedo, 1.0);
        let lease = bench.one(0, "a");
        assert_eq!((lease.key.dictionary, lease.key.job), (FIRST, 2));
        bench.finish(1, "a", &lease);
        bench.farm.taken_over((SECOND, 2), Walks::PAPER, of_heir, Some(origin("a")));
        bench.desire(FIRST, DesiredState::Cancel);
        bench.farm.remove_dictionary(FIRST);
        let (part, _) = bench.judge(of_heir);
        assert_eq!(part.job_ref(), (SECOND, 2));
        assert_eq!(bench.farm.verification.counts(), (1, 0, 0));
    }
}

/// A late job whose walks are needed by another dictionary gets a second copy.
#[test]
fn shared_straggler_gets_a_second_copy() {
    let mut bench = overlapping(&[0.9], 0.0);
    let leases = bench.acquire(0, "a", 9);
    for lease in &leases[1..] {
        bench.finish(1, "a", lease);
        for place in bench.farm.schedule.served_by((lease.key.dictionary, lease.key.job)) {
            bench.farm.taken_over(place, Walks::PAPER, DIGEST, None);
        }
    }
    bench.look_at(&[4, 9, 14, 18]);
    assert_eq!(places(&bench.acquire(18, "b", 9)), [(FIRST, 2)]);
}

/// The expected end of the second dictionary at two times, once three results have come.
fn expected_ends(bench: &Bench, at: [u64; 2]) -> [f64; 2] {
    let second = bench.farm.schedule.by_id(SECOND).unwrap();
    at.map(|at| bench.farm.status_of(seconds(at), second).eta_s.expect("the pace is known"))
}

/// A request in vain does not make the time without work count: the expected end stays the same.
#[test]
fn requests_in_vain_keep_the_pace() {
    let mut bench = overlapping(&[0.9, 0.95], 0.0);
    bench.desire(SECOND, DesiredState::Pause);
    let leases = bench.acquire(0, "a", 9);
    (1..).zip(&leases).for_each(|(at, lease)| bench.finish(at, "a", lease));
    assert!(leases.len() == 3 && bench.acquire(3, "a", 9).is_empty());
    bench.desire(SECOND, DesiredState::Run);
    let [soon, later] = expected_ends(&bench, [3, 100]);
    assert!(soon > 0.0 && soon == later, "{soon:?} {later:?}");
}

/// Time counts for the pace while leases are out, and not after the last result.
#[test]
fn pace_counts_time_with_leases_only() {
    let mut bench = overlapping(&[0.9], 0.0);
    let leases = bench.acquire(0, "a", 9);
    (1..).zip(&leases[..3]).for_each(|(at, lease)| bench.finish(at, "a", lease));
    let [soon, later] = expected_ends(&bench, [3, 100]);
    assert!(later > soon, "one is out: {soon} {later}");
    bench.finish(4, "a", &leases[3]);
    let [soon, later] = expected_ends(&bench, [4, 100]);
    assert_eq!(soon, later, "none is out");
}
