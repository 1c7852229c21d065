//! Tests that failed attempts count against the right job and machine.

use farm_proto::status::DictionaryState;

use super::{Bench, DIGEST, FIRST, about, job_of, origin, seconds, worker};
use crate::dispatch::{Effect, EventKind};

/// A job is given up after the allowed number of failures. Its reasons name the logs of the workers, and a retry puts it
/// back into the queue.
#[test]
fn given_up_job_keeps_all_reasons() {
    let mut bench = Bench::new(&[]);
    for name in ["a", "b"] {
        let mut logged = about(name);
        logged.facts.log = format!("node7:/var/log/{name}.out");
        bench.register(0, name, origin(name), logged).unwrap();
    }
    let tells = |bench: &Bench, second, code: &str, part: &str| {
        let reasons = bench.farm.explain(seconds(second), bench.farm.schedule.by_id(FIRST).unwrap());
        assert!(reasons.iter().any(|r| r.code == code && r.text.contains(part)), "{part}: {reasons:?}");
    };
    let first = bench.one(0, "a");
    bench.fail(1, "a", &first);
    assert!(bench.farm.take_outbox().effects.is_empty());
    let failed = "attempt 1: boom (log: node7:/var/log/a.out)";
    tells(&bench, 1, "RETRYING", failed);
    let second = bench.one(1, "b");
    assert_eq!(second.key.job, first.key.job);
    assert!(bench.renew(1, "b", &second, true));
    bench.look(4..40);
    let silent = "worker b fell silent while it computed this job (log: node7:/var/log/b.out)";
    let (job, reason) = (first.key.job, format!("{failed}; attempt 2: {silent}"));
    let given_up = Effect::GiveUp { dictionary: FIRST, job, reason: reason.clone(), quarantined: true };
    assert_eq!(bench.effects(), [given_up]);
    let left = bench.acquire(40, "c", 10);
    bench.finish_all(41, "c", &left);
    assert_eq!(bench.state(), DictionaryState::Failed);
    tells(&bench, 41, "JOBS_GIVEN_UP", &format!("1 jobs were given up, the first is job 2 ({reason})"));
    assert_eq!(bench.farm.retry(FIRST), 1);
    assert_eq!(job_of(&bench.acquire(42, "c", 10)), [job]);
}

/// A worker that was asked to stop before its host was preempted is not blamed for its silence.
#[test]
fn silence_after_preemption_has_no_blame() {
    let mut bench = Bench::new(&[]);
    let lease = bench.one(0, "a");
    assert!(bench.renew(0, "a", &lease, true));
    bench.farm.roster.stopping(&worker("a"));
    bench.look(0..40);
    assert_eq!(bench.status().jobs_leased, 0, "its lease has ended");
    let events = bench.farm.take_outbox().events;
    assert!(events.iter().all(|event| event.kind != EventKind::AttemptFailed), "{events:?}");
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
