//! Tests that failed attempts count against the right job and machine.

use farm_proto::status::DictionaryState;

use super::{Bench, DIGEST, FIRST, about, job_of, origin, seconds, worker};
use crate::dispatch::{Effect, EventKind};
use crate::stored::Origin;

/// A job is given up after the allowed number of failures, and a retry puts it back into the queue.
#[test]
fn given_up_job_keeps_all_reasons() {
    let mut bench = Bench::new(&[]);
    let first = bench.acquire(0, "a", 1);
    bench.farm.failed(seconds(1), &worker("a"), &first[0].key, "boom").unwrap();
    assert!(bench.farm.take_outbox().effects.is_empty());
    let second = bench.acquire(1, "b", 1);
    assert_eq!(second[0].key.job, first[0].key.job);
    assert!(bench.reasons(1).contains(&"RETRYING"));
    bench.farm.failed(seconds(2), &worker("b"), &second[0].key, "bang").unwrap();
    let reason = "attempt 1: boom; attempt 2: bang".to_owned();
    let job = first[0].key.job;
    let given_up = Effect::GiveUp { dictionary: FIRST, job, reason, quarantined: false };
    assert_eq!(bench.farm.take_outbox().effects, [given_up]);
    let left = bench.acquire(2, "a", 10);
    bench.finish_all(3, "a", &left);
    assert_eq!(bench.state(), DictionaryState::Failed);
    assert!(bench.reasons(3).contains(&"JOBS_GIVEN_UP"));
    assert_eq!(bench.farm.retry(FIRST), 1);
    assert_eq!(job_of(&bench.acquire(4, "c", 10)), [job]);
}

/// A worker that was asked to stop before its host was preempted is not blamed for its silence.
#[test]
fn silence_after_preemption_has_no_blame() {
    let mut bench = Bench::new(&[]);
    // More rounds than a job may have failures.
    for round in 0..5 {
        let at = 40 * round;
        let id = format!("a{round}");
        bench.register(at, &id, origin("a"), about(&id)).unwrap();
        let lease = bench.acquire(at, &id, 1);
        assert!(bench.renew(at, &id, &lease[0], true));
        bench.farm.roster.stopping(&worker(&id));
        bench.look(at..at + 40);
        assert_eq!(bench.status().jobs_leased, 0, "its lease has ended");
        let events = bench.farm.take_outbox().events;
        assert!(events.iter().all(|event| event.kind != EventKind::AttemptFailed), "{events:?}");
    }
    assert_eq!(bench.state(), DictionaryState::Running);
}

/// The explanation of a failed job gives the place of the worker's log.
#[test]
fn failed_job_names_its_log() {
    let mut bench = Bench::new(&[]);
    for name in ["a", "b"] {
        let mut logged = about(name);
        logged.facts.log = format!("node7:/var/log/{name}.out");
        bench.register(0, name, origin(name), logged).unwrap();
    }
    let told = |bench: &Bench, second| {
        let reasons = bench.farm.explain(seconds(second), bench.farm.schedule.by_id(FIRST).unwrap());
        reasons.into_iter().map(|reason| reason.text).collect::<Vec<_>>().join("\n")
    };
    let first = bench.acquire(0, "a", 1);
    bench.farm.failed(seconds(1), &worker("a"), &first[0].key, "boom").unwrap();
    assert!(told(&bench, 1).contains("attempt 1: boom (log: node7:/var/log/a.out)"), "{}", told(&bench, 1));
    let second = bench.acquire(1, "b", 1);
    assert!(bench.renew(1, "b", &second[0], true));
    bench.look(4..40);
    let text = told(&bench, 40);
    let expected = "1 jobs were given up, the first is job 2 (attempt 1: boom (log: node7:/var/log/a.out); attempt 2: \
                    worker b fell silent while it computed this job (log: node7:/var/log/b.out))";
    assert!(text.contains(expected), "{text}");
}

/// When a worker dies, only the job that was running is blamed.
#[test]
fn crash_blames_only_running_jobs() {
    let mut bench = Bench::new(&[]);
    for round in 0..2 {
        let at = 100 * round;
        bench.farm.look_over(seconds(at));
        let leases = bench.acquire(at, "a", 2);
        assert_eq!(job_of(&leases), [2, 1], "the longest first");
        assert!(bench.renew(at, "a", &leases[0], true));
        assert!(bench.renew(at, "a", &leases[1], false));
        // The process dies; another one comes in its place.
        bench.look(at + 4..at + 40);
        bench.register(at + 40, "a", Origin(10 + round as i64), about("a")).unwrap();
    }
    let status = bench.status();
    assert_eq!(status.failed.len(), 1);
    assert_eq!((status.failed[0].job, status.failed[0].quarantined), (2, true));
    assert!(status.failed[0].reason.contains("worker a fell silent"), "{}", status.failed[0].reason);
    assert_eq!(job_of(&bench.acquire(300, "b", 9)), [1, 0], "the others continue");
}

/// A worker that comes back lifts the blame from its jobs.
#[test]
fn returning_worker_lifts_blame_from_jobs() {
    let mut bench = Bench::new(&[]);
    for round in 0..5 {
        let at = 100 * round;
        let lease = bench.acquire(at, "a", 1);
        assert_eq!(job_of(&lease), [2], "it was not given up");
        bench.farm.look_over(seconds(at));
        assert!(bench.renew(at, "a", &lease[0], true));
        bench.look(at + 4..at + 40);
        assert!(bench.renew(at + 50, "a", &lease[0], true), "no other worker has it: it continues");
        bench.farm.hand_back(&[lease[0].key]);
        bench.farm.look_over(seconds(at + 54));
    }
}

/// A coordinator that was itself stopped does not expire leases for that time.
#[test]
fn stopped_coordinator_blames_no_worker() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    bench.farm.look_over(seconds(1));
    assert_eq!(bench.farm.look_over(seconds(1000)), 0, "it was away for 999 s, not the worker");
    assert!(bench.renew(1001, "a", &lease[0], true));
}

/// Leases that are handed back do not count as failures.
#[test]
fn returned_leases_carry_no_blame() {
    let mut bench = Bench::new(&[]);
    for _ in 0..5 {
        let key = bench.one(0, "a").key;
        bench.farm.hand_back(&[key]);
    }
    assert_eq!(bench.acquire(0, "a", 10).len(), 3);
    assert_eq!(bench.state(), DictionaryState::Running);
}

/// A result that is not needed ends its lease without blame.
#[test]
fn unwanted_result_ends_its_lease() {
    let mut bench = Bench::new(&[]);
    for second in (0..20).step_by(4) {
        let lease = bench.acquire(second, "a", 1);
        assert!(bench.renew(second, "a", &lease[0], true));
        assert!(bench.farm.admit(seconds(second), &worker("a"), &lease[0].key, DIGEST).is_err());
        assert_eq!(bench.status().jobs_leased, 0);
    }
}

/// A worker that was removed for its silence and registers again did not crash, so its job is not to blame.
#[test]
fn reregistered_worker_clears_its_jobs() {
    let mut bench = Bench::new(&[]);
    for round in 0..3 {
        let at = 1000 * round;
        let id = format!("a{round}");
        bench.register(at, &id, Origin(7), about("a")).unwrap();
        bench.farm.look_over(seconds(at));
        let lease = bench.acquire(at, &id, 1);
        assert_eq!(job_of(&lease), [2], "it was not given up");
        assert!(bench.renew(at, &id, &lease[0], true));
        bench.look(at + 4..at + 800);
    }
}
