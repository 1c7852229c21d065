//! Tests checks, disputes, and fenced-off machines.

use super::{Bench, DIGEST, FIRST, WRONG, about, arrive, done, job_of, seconds};
use crate::dispatch::DispatchError;
use crate::stored::Origin;

/// Checks that were not made before a restart are requested after it.
#[test]
fn open_checks_are_resumed_after_restart() {
    // One machine computed job 0 alone; two agreed on job 1; the records of job 2 came for a dictionary that is gone.
    let ended = [done(0, Some(Origin(1)), false), done(1, None, false), done(2, Some(Origin(1)), true)];
    let mut bench = Bench::with_checks(&ended, 1.0);
    assert!(bench.acquire(0, "a", 9).is_empty(), "not its own result");
    assert_eq!(job_of(&bench.acquire(0, "b", 9)), [0, 2]);
    assert!(Bench::with_checks(&ended, 0.0).acquire(0, "b", 9).is_empty());
}

/// Jobs of two dictionaries with different records for the same walks are checked, even if no results are sampled.
#[test]
fn conflicting_shared_records_are_always_checked() {
    let mut bench = Bench::with_checks(&[], 0.0);
    let lease = bench.acquire(0, "a", 1);
    arrive("a", &lease[0], |arrived| bench.farm.contradict(seconds(0), arrived, Some(&[(FIRST, 0)])));
    let again = bench.acquire(1, "b", 1);
    assert_eq!(again[0].key.job, lease[0].key.job, "it waits again");
    bench.finish(2, "b", &again[0]);
    assert_eq!(job_of(&bench.acquire(3, "c", 1)), job_of(&again));
    let other = bench.acquire(4, "a", 9).into_iter().find(|lease| lease.key.job == 0).unwrap();
    bench.finish(5, "a", &other);
    assert_eq!(job_of(&bench.acquire(6, "b", 1)), [0], "so does the other one");
}

/// A result that was admitted while the job had other records than now accuses no machine.
#[test]
fn results_are_not_compared_with_replaced_records() {
    let mut bench = Bench::with_checks(&[], 0.0);
    let lease = bench.acquire(0, "a", 1);
    bench.finish_with(1, "a", &lease[0], DIGEST);
    // Another result was admitted while the job had other records.
    for _ in 0..3 {
        bench.compare("b", &lease[0], WRONG, DIGEST);
    }
    assert_eq!(bench.farm.verification.counts(), (0, 0, 0), "no machine is accused");
    assert!(bench.effects().is_empty());
}

/// The second result differs and arrives before the first is noted: another machine checks.
#[test]
fn simultaneous_different_results_trigger_a_check() {
    let mut bench = Bench::with_checks(&[], 0.0);
    let lease = bench.acquire(0, "a", 1);
    // Before the first is noted.
    bench.compare("b", &lease[0], WRONG, DIGEST);
    bench.finish_with(1, "a", &lease[0], WRONG);
    assert!(!job_of(&bench.acquire(2, "a", 1)).contains(&lease[0].key.job), "not by itself");
    assert_eq!(job_of(&bench.acquire(2, "b", 1)), job_of(&lease));
}

/// Checks that no connected machine may make are explained.
#[test]
fn blocked_checks_are_explained() {
    let mut bench = Bench::with_checks(&[], 1.0);
    bench.leave(&["b", "c"]);
    let leases = bench.acquire(0, "a", 9);
    bench.finish_all(1, "a", &leases);
    assert!(bench.acquire(2, "a", 9).is_empty(), "it has computed all of them");
    assert_eq!(bench.reasons(2), ["CHECKS_WAIT", "DONE"]);
    bench.join(3, "b");
    assert_eq!(bench.reasons(3), ["DONE"]);
}

/// The workers of one token leave room for those of others, and a registered process can register again.
#[test]
fn workers_per_token_are_limited() {
    use crate::dispatch::roster::WORKERS_OF_ONE;
    let mut bench = Bench::with_checks(&[], 1.0);
    let mut register = |token: &str, instance: usize| {
        let mut about = about(&instance.to_string());
        about.machine.token = token.to_owned();
        bench.register(0, &format!("{token}{instance}"), Origin(9), about)
    };
    (0..WORKERS_OF_ONE).for_each(|instance| register("mallory", instance).unwrap());
    let refused = register("mallory", WORKERS_OF_ONE).unwrap_err();
    assert!(matches!(refused, DispatchError::ManyWorkers { .. }), "{refused}");
    register("mallory", 7).unwrap();
    register("alice", WORKERS_OF_ONE).unwrap();
}
