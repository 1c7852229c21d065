//! Tests machines that fail at every job, and workers that never deliver a result.

use farm_proto::ids::WorkerId;
use farm_proto::status::WorkerState;

use super::{Bench, job_of, on, seconds, worker};
use crate::stored::Origin;

impl Bench {
    /// Fails at every job that a worker is given at a moment; returns their number.
    fn fail_all(&mut self, at: u64, name: &str) -> usize {
        let failures = std::iter::from_fn(|| {
            let lease = self.acquire(at, name, 1).pop()?;
            self.fail(at, name, &lease);
            Some(lease)
        });
        failures.count()
    }

    fn state_of(&self, at: u64, name: &str) -> (WorkerState, u64) {
        let all = self.farm.workers(seconds(at), &WorkerId(String::new()), 9);
        let of_it = all.iter().find(|w| w.id == worker(name)).unwrap();
        (of_it.state, of_it.suspended_ms)
    }
}

/// A machine that fails at every job is suspended; its failures alone give up no job while other machines are connected.
/// After its pause it gets one job, however many processes it runs, and a good result ends the suspension.
#[test]
fn suspended_machine_is_tried_with_one_job() {
    let mut bench = Bench::new(&[]);
    assert_eq!(bench.fail_all(0, "a"), 3, "each of the jobs once");
    assert_eq!((bench.status().jobs_failed, bench.state_of(0, "a")), (0, (WorkerState::Suspended, 10_000)));
    assert!(bench.reasons(0).contains(&"WORKERS_SUSPENDED"));
    // The other workers are silent from now on.
    bench.farm.take_outbox();
    bench.look(0..41);
    assert!(bench.farm.take_outbox().work, "the end of its pause is signalled");
    let lease = bench.acquire(40, "a", 9);
    assert_eq!(lease.len(), 1);
    bench.register(40, "d", Origin(1), on("a", "d")).unwrap();
    assert!(bench.acquire(40, "d", 9).is_empty(), "another process is the same machine");
    bench.finish(41, "a", &lease[0]);
    assert_eq!(bench.acquire(41, "a", 9).len(), 2);
}

/// Failures on one machine count once, as long as other machines are connected that could try the job.
#[test]
fn failures_on_one_machine_count_once() {
    let mut bench = Bench::new(&[]);
    let mut grant = bench.acquire(0, "a", 1);
    let job = grant[0].key.job;
    bench.fail(0, "a", &grant[0]);
    bench.register(0, "d", Origin(1), on("a", "d")).unwrap();
    assert!(!job_of(&bench.acquire(0, "d", 9)).contains(&job), "b or c are to try it");
    grant = bench.acquire(1, "b", 1);
    assert_eq!(grant[0].key.job, job);
    bench.fail(1, "b", &grant[0]);
    assert_eq!(bench.status().jobs_failed, 1, "two machines are as many as are allowed");
}

/// A job that fails on every machine suspends none of them.
#[test]
fn job_that_fails_everywhere_blames_itself() {
    let mut bench = Bench::new(&[]);
    bench.leave(&["c"]);
    bench.fail_all(0, "a");
    bench.fail_all(0, "b");
    assert_eq!(bench.status().jobs_failed, 3);
    for name in ["a", "b"] {
        assert_eq!(bench.state_of(0, name), (WorkerState::Idle, 0), "{name}");
    }
}

/// With a single machine, a job is given up after the allowed number of attempts.
#[test]
fn lone_machine_gives_up_after_its_attempts() {
    let mut bench = Bench::new(&[]);
    bench.leave(&["b", "c"]);
    for second in 0..2 {
        let lease = bench.one(second, "a");
        assert_eq!(lease.key.job, 2);
        bench.fail(second, "a", &lease);
    }
    assert_eq!(bench.status().jobs_failed, 1);
}

/// A worker that renews for a day without a result loses its lease.
#[test]
fn endless_renewal_loses_the_lease() {
    let mut bench = Bench::new(&[]);
    let lease = bench.acquire(0, "a", 1);
    let day = 24 * 3600;
    for second in (0..=day).step_by(4) {
        bench.farm.look_over(seconds(second));
        assert!(second % 20 != 0 || bench.renew(second, "a", &lease[0], true), "{second}");
    }
    assert_eq!(bench.farm.look_over(seconds(day + 4)), 1);
    bench.join(day + 4, "b");
    assert_eq!(bench.acquire(day + 4, "b", 1)[0].key.job, lease[0].key.job);
    assert!(bench.reasons(day + 4).contains(&"RETRYING"), "it counts as a failure");
}
