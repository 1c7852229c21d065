//! Whole workers, from the first lease to deregistration. The clock is paused in tests that trace nothing.

use std::collections::BTreeSet;

use farm_link::Target;
use farm_proto::lease::LeaseKey;
use optics_model::sums::result_bytes;
use tonic::Status;

use super::*;
use crate::testing::{
    Answer, Call, Coordinator, DeliveredResult, Method, as_thick_as, endless_job, job, lease, lease_of,
    session,
};

/// Heartbeats come every 50 ms.
const SHORT_LEASE: Duration = Duration::from_millis(200);
const FOREVER: Duration = Duration::from_hours(1);
/// An idle worker ends after this time.
const SOON: Option<Duration> = Some(Duration::from_millis(50));

/// A running worker.
struct RunningWorker {
    coordinator: Coordinator,
    shutdown: CancellationToken,
    worker: JoinHandle<Result<EndReason, Error>>,
}

impl RunningWorker {
    fn start(coordinator: &Coordinator, change: impl FnOnce(Config) -> Config) -> Self {
        let config = Config { threads: 1, grace: FOREVER, ..config() };
        let shutdown = CancellationToken::new();
        let worker = tokio::spawn(work_over(coordinator.link(), change(config), shutdown.clone()));
        Self { coordinator: coordinator.clone(), shutdown, worker }
    }

    async fn ended(self) -> Result<EndReason, Error> {
        timeout(Duration::from_mins(1), self.worker).await.expect("the worker ends").unwrap()
    }

    /// Waits until a renewal reports these jobs as running. Others may run too: a thread that waits for another
    /// thread's part of a job begins the next job meanwhile.
    async fn runs(&self, jobs: &[u32]) {
        let running = |call: &Call| {
            let leases = call.renew()?.leases;
            let running: BTreeSet<_> =
                leases.iter().filter(|l| l.running).map(|l| l.key.as_ref().unwrap().job).collect();
            jobs.iter().all(|job| running.contains(job)).then_some(())
        };
        self.coordinator.wait_for(1, running).await;
    }

    /// Waits until a renewal names only this job and reports it as running.
    async fn runs_only(&self, job: u32) {
        let running = |call: &Call| match &call.renew()?.leases[..] {
            [lease] => (lease.running && lease.key.as_ref()?.job == job).then_some(()),
            _ => None,
        };
        self.coordinator.wait_for(1, running).await;
    }
}

fn config() -> Config {
    Config::new(Target::new(None, Some("http://test")).unwrap())
}

fn coordinator() -> Coordinator {
    let coordinator = Coordinator::start();
    coordinator.set_lease(SHORT_LEASE);
    coordinator
}

fn delivered(coordinator: &Coordinator) -> Vec<DeliveredResult> {
    let mut results = coordinator.calls(Call::results).concat();
    results.sort_unstable_by_key(|result| result.key.job);
    results
}

/// Jobs of each call that hands leases back, and whether the call deregistered the worker: the last of all does.
fn handed_back(coordinator: &Coordinator) -> Vec<(Vec<u32>, bool)> {
    let calls = coordinator.calls(Call::hand_back);
    assert!(calls.iter().all(|call| call.stopping));
    let last = coordinator.calls(|call| Some(call.clone())).pop().and_then(|call| call.hand_back());
    assert!(calls.is_empty() || last.is_some_and(|call| call.leaving), "it would be registered again");
    calls.into_iter().map(|c| (c.leases.into_iter().map(|key| key.job).collect(), c.leaving)).collect()
}

/// Checked for whole jobs, jobs with shared walks, which take one slot, and a block of a divided job, with the expected
/// number of bytes.
#[tokio::test]
async fn idle_worker_delivers_before_exit() {
    let coordinator = coordinator();
    let set = [lease(0), lease_of(1, as_thick_as(0)), lease(2)];
    assert_eq!(sets(set.to_vec()).iter().map(Vec::len).collect::<Vec<_>>(), [2, 1]);
    let all = [&set[..], &[lease(3), lease_of(4, job(9).with_block(0).unwrap())]].concat();
    coordinator.offer(all.clone());
    let running = RunningWorker::start(&coordinator, |config| Config { idle_exit: SOON, ..config });
    assert_eq!(running.ended().await.unwrap(), EndReason::Idle);
    let results = delivered(&coordinator);
    for (result, lease) in results.iter().zip(&all) {
        assert_eq!((result.key, result.bytes), (lease.key, result_bytes(&lease.job)));
        assert_eq!(result.identity, lease.job.identity().as_bytes());
    }
    assert_eq!(results.len(), all.len());
    assert_eq!(handed_back(&coordinator), [(vec![], true)]);
}

/// A worker holds one job more than it has threads.
#[tokio::test]
async fn worker_holds_one_job_more_than_threads() {
    let coordinator = coordinator();
    coordinator.offer((0..9).map(|n| lease_of(n, endless_job(n.into()))));
    let running =
        RunningWorker::start(&coordinator, |config| Config { threads: 2, grace: Duration::ZERO, ..config });
    running.runs(&[0, 1]).await;
    let max_leases: Vec<_> = coordinator.calls(Call::acquire).iter().map(|call| call.max_leases).collect();
    assert_eq!(max_leases, [3]);
    running.shutdown.cancel();
    assert_eq!(running.ended().await.unwrap(), EndReason::Stopped);
}

/// Jobs that have not begun are handed back first, then those that do not finish within the grace period. The stop is
/// announced also without such jobs: the worker may be killed before its grace is over.
#[tokio::test]
async fn stopped_worker_hands_back_unfinished_jobs() {
    for waiting in [vec![], vec![1]] {
        let coordinator = coordinator();
        coordinator
            .offer([lease_of(0, endless_job(0))].into_iter().chain(waiting.iter().copied().map(lease)));
        let grace = Duration::from_millis(100);
        let running = RunningWorker::start(&coordinator, |config| Config { grace, ..config });
        running.runs(&[0]).await;
        running.shutdown.cancel();
        assert_eq!(running.ended().await.unwrap(), EndReason::Stopped);
        assert!(delivered(&coordinator).is_empty());
        assert_eq!(handed_back(&coordinator), [(waiting, false), (vec![0], true)]);
    }
}

/// A lost lease makes room for the next job.
#[tokio::test]
async fn lost_lease_makes_room_for_the_next() {
    let coordinator = coordinator();
    let [lost, next] = [0, 1].map(|n| lease_of(n, endless_job(0)));
    coordinator.offer([lost.clone(), next]);
    let running = RunningWorker::start(&coordinator, |config| Config { grace: Duration::ZERO, ..config });
    running.runs(&[0]).await;
    coordinator.lose(lost.key);
    running.runs_only(1).await;
    running.shutdown.cancel();
    assert_eq!(running.ended().await.unwrap(), EndReason::Stopped);
    assert_eq!(handed_back(&coordinator), [(vec![1], true)]);
}

/// The jobs of a fenced worker are stopped, and it makes no further calls for them.
#[tokio::test]
async fn fenced_worker_stops_with_the_reason() {
    let coordinator = coordinator();
    let fenced = Status::permission_denied("this worker is fenced off: its records were wrong");
    coordinator.offer([lease_of(0, endless_job(0))]);
    let running = RunningWorker::start(&coordinator, |config| config);
    running.runs(&[0]).await;
    coordinator.answer(Method::Acquire, Answer::Error(fenced));
    // Ends the call that waits for work.
    coordinator.restart(SHORT_LEASE);
    let error = running.ended().await.unwrap_err().to_string();
    let reason = "this worker is fenced off: its records were wrong";
    assert_eq!(error, format!("the coordinator refused this worker: {reason}"));
    assert_eq!(handed_back(&coordinator), []);
}

/// Grace and delivery fit into the time limit.
#[test]
fn grace_and_delivery_fit_the_time_limit() {
    // Half of a short limit is for running.
    for (limit_s, grace_s, expected_s) in [(3600, 10, 3585), (20, 10, 10), (10, 60, 5)] {
        let (time_limit, grace) = (Some(Duration::from_secs(limit_s)), Duration::from_secs(grace_s));
        let config = Config { grace, time_limit, ..config() };
        assert_eq!(working_time(&config).as_secs(), expected_s, "{limit_s}");
    }
}

/// Jobs that do not stop and a delivery that never succeeds end within the documented limits.
#[tokio::test(start_paused = true)]
async fn endless_work_is_abandoned_in_time() {
    let coordinator = Coordinator::start();
    let (session, held) = session(&coordinator).await;
    let agent = Agent::new(session, held.clone(), &config());
    coordinator.set_down(true);
    let switches = held.add(lease(0).key, job(0).identity(), SetSwitch::new(1));
    assert!(switches.start());
    let (dropped, gone) = tokio::sync::oneshot::channel::<()>();
    let mut jobs = JoinSet::new();
    jobs.spawn(async move {
        let _held = dropped;
        std::future::pending::<()>().await;
    });
    let (start, grace) = (Instant::now(), Duration::from_secs(30));
    agent.wind_up(jobs, tokio::spawn(std::future::pending()), grace).await;
    assert_eq!(start.elapsed().as_secs(), (grace + STOPPING + DELIVERY).as_secs());
    assert!(switches.is_stopped());
    gone.await.unwrap_err();
}

/// Sets of jobs are divided so that they fit into memory, and the coordinator may lease several retried jobs together.
#[test]
fn sets_fit_memory_and_have_no_retries() {
    let lengths = |leases| sets(leases).iter().map(Vec::len).collect::<Vec<_>>();
    assert_eq!(lengths((0..40).map(|n| lease_of(n, job(0))).collect()), [16, 16, 8]);
    let again = |lease: Lease| Lease { key: LeaseKey { attempt: 2, ..lease.key }, ..lease };
    assert_eq!(lengths([lease(0), lease_of(1, as_thick_as(0))].map(again).to_vec()), [1, 1]);
}
