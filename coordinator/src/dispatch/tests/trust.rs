//! Tests checks, disputes, and fenced-off machines.

use farm_proto::ids::DictionaryId;
use optics_model::{Digest, Walks};

use super::{Bench, DIGEST, about, arrive, job_of, origin, seconds, worker};
use crate::dispatch::{DispatchError, Effect};
use crate::stored::{EndedJob, Origin};

/// One vote against one decides nothing. The third fences the machine with the wrong result.
#[test]
fn third_worker_settles_a_failed_check() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let wrong = Digest::from_bytes([9; 32]);
    let lease = bench.acquire(0, "a", 1);
    bench.finish_with(1, "a", &lease[0], wrong);
    assert!(!job_of(&bench.acquire(2, "a", 1)).contains(&lease[0].key.job), "not its own result");
    let check = bench.acquire(2, "b", 1);
    assert_eq!(check[0].key.job, lease[0].key.job);
    bench.compare("b", &check[0], wrong, DIGEST);
    assert!(bench.reasons(2).contains(&"DISPUTED"));
    assert!(bench.effects().is_empty(), "one against one decides nothing");
    let third = bench.acquire(3, "c", 1);
    assert_eq!(third[0].key.job, lease[0].key.job);
    bench.compare("c", &third[0], wrong, DIGEST);
    let effects = bench.effects();
    assert!(matches!(&effects[..], [Effect::Fence { machine: Origin(1), .. }]), "{effects:?}");
    let fenced = bench.farm.acquire(seconds(4), &worker("a"), 1, &mut bench.chance).unwrap_err();
    assert!(matches!(fenced, DispatchError::Fenced(_)));
    let again = bench.farm.register(seconds(5), worker("z"), Origin(1), about("z"));
    assert!(again.is_err(), "the same process does not come in by another door");
    bench.farm.reopen(DictionaryId(1), &[lease[0].key.job]);
    assert!(job_of(&bench.acquire(6, "b", 9)).contains(&lease[0].key.job), "its records are computed again");
}

/// Equal results of two machines agree. A machine's own repetition confirms nothing, but a different one fences it.
#[test]
fn worker_that_contradicts_itself_is_fenced() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let lease = bench.acquire(0, "a", 1);
    bench.finish(1, "a", &lease[0]);
    // The machine repeats its own result.
    bench.compare("a", &lease[0], DIGEST, DIGEST);
    let check = bench.acquire(2, "b", 1);
    assert_eq!(check[0].key.job, lease[0].key.job, "which proves nothing: the check is still needed");
    bench.compare("b", &check[0], DIGEST, DIGEST);
    assert_eq!(bench.farm.verification.counts(), (1, 0, 0));
    let agreed = bench.effects();
    assert!(matches!(&agreed[..], [Effect::Agreed { job: 2, machine: Origin(2), .. }]), "{agreed:?}");
    bench.compare("a", &lease[0], DIGEST, Digest::from_bytes([1; 32]));
    assert!(matches!(&bench.effects()[..], [Effect::Fence { machine: Origin(1), .. }]));
}

/// A part whose result is being checked is not late.
#[test]
fn part_under_check_is_not_late() {
    let mut bench = Bench::with_checks(&[], 1.0);
    let leases = bench.acquire(0, "a", 3);
    bench.finish(1, "a", &leases[1]);
    bench.finish(1, "a", &leases[2]);
    for second in (4..=20).step_by(4) {
        bench.farm.look_over(seconds(second));
    }
    bench.finish(20, "a", &leases[0]);
    assert_eq!(bench.acquire(20, "b", 3).len(), 3, "the checks");
    assert!(bench.acquire(20, "c", 3).is_empty());
}

/// Checks that were not made before a restart are requested after it.
#[test]
fn open_checks_are_resumed_after_restart() {
    let done = |job, by, reused| EndedJob::Done {
        job,
        walks: Walks::PAPER,
        records: DIGEST,
        by,
        confirmed: vec![],
        reused,
    };
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
    arrive("a", &lease[0], |arrived| {
        bench.farm.contradict(seconds(0), arrived, Some(&[(DictionaryId(1), 0)]));
    });
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
    let (wrong, right) = (Digest::from_bytes([9; 32]), DIGEST);
    let lease = bench.acquire(0, "a", 1);
    bench.finish_with(1, "a", &lease[0], right);
    // Another result was admitted while the job had other records.
    for _ in 0..3 {
        bench.compare("b", &lease[0], wrong, right);
    }
    assert_eq!(bench.farm.verification.counts(), (0, 0, 0), "no machine is accused");
    assert!(bench.effects().is_empty());
}

/// The second result differs and arrives before the first is noted: another machine checks.
#[test]
fn simultaneous_different_results_trigger_a_check() {
    let mut bench = Bench::with_checks(&[], 0.0);
    let wrong = Digest::from_bytes([9; 32]);
    let lease = bench.acquire(0, "a", 1);
    // Before the first is noted.
    bench.compare("b", &lease[0], wrong, DIGEST);
    bench.finish_with(1, "a", &lease[0], wrong);
    assert!(!job_of(&bench.acquire(2, "a", 1)).contains(&lease[0].key.job), "not by itself");
    assert_eq!(job_of(&bench.acquire(2, "b", 1)), job_of(&lease));
}

/// Checks that no connected machine may make are explained.
#[test]
fn blocked_checks_are_explained() {
    let mut bench = Bench::with_checks(&[], 1.0);
    for name in ["b", "c"] {
        bench.farm.leave(&worker(name));
    }
    let leases = bench.acquire(0, "a", 9);
    for lease in &leases {
        bench.finish(1, "a", lease);
    }
    assert!(bench.acquire(2, "a", 9).is_empty(), "it has computed all of them");
    assert_eq!(bench.reasons(2), ["CHECKS_WAIT", "DONE"]);
    bench.farm.register(seconds(3), worker("b"), origin("b"), about("b")).unwrap();
    assert_eq!(bench.reasons(3), ["DONE"]);
}

/// The workers of one token leave room for those of others, and a registered process can register again.
#[test]
fn workers_per_token_are_limited() {
    use crate::dispatch::roster::WORKERS_OF_ONE;
    let mut bench = Bench::with_checks(&[], 1.0);
    let of = |token: &str, instance: usize| {
        let mut about = about(&instance.to_string());
        about.instance = instance.to_string();
        about.machine.token = token.to_owned();
        about
    };
    let mut register = |token: &str, instance: usize| {
        let id = worker(&format!("{token}{instance}"));
        bench.farm.register(seconds(0), id, Origin(9), of(token, instance))
    };
    for instance in 0..WORKERS_OF_ONE {
        register("mallory", instance).unwrap();
    }
    let refused = register("mallory", WORKERS_OF_ONE).unwrap_err();
    assert!(matches!(refused, DispatchError::ManyWorkers { .. }), "{refused}");
    register("mallory", 7).unwrap();
    register("alice", WORKERS_OF_ONE).unwrap();
}
