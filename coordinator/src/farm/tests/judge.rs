//! Tests disputes from the results of workers to the records in the store.

use super::*;

/// Waits until the coordinator has settled all checks.
pub(super) async fn settled(farm: &Farm) {
    let waiting = || farm.overview().checks.2;
    tokio::time::timeout(std::time::Duration::from_secs(20), async {
        while waiting() > 0 {
            tokio::time::sleep(std::time::Duration::from_millis(5)).await;
        }
    })
    .await
    .expect("the checks are settled");
    // The coordinator holds it until the verdict is carried out.
    drop(farm.store.ledger().exclusive().await);
    farm.scheduler.settled().await;
}

/// The numbers of a job's records.
async fn value_of(farm: &Farm, name: &DictionaryName, job: u32) -> f32 {
    let first = 2 * job as usize;
    let records = farm.records(name, first..first + 2).await.unwrap();
    records[0].profiles[0].radiance_factor.values()[0]
}

async fn is_fenced(farm: &Farm, label: &str) -> bool {
    let versions = Versions { physics: PHYSICS_VERSION, protocol: PROTOCOL_VERSION };
    farm.register(process(Machine::at(label), label), versions).await.is_err()
}

/// Lets two machines deliver results of one job, of which one is wrong; the first value is stored.
async fn contradicted(farm: &Farm, first: (&str, f32), second: (&str, f32)) -> u32 {
    let [one, other] = [worker(farm, first.0).await, worker(farm, second.0).await];
    let lease = lease(farm, &one).unwrap();
    let job = lease.key.job;
    deliver(farm, &one, &lease, value(job) + first.1).await;
    let outcome = deliver(farm, &other, &lease, value(job) + second.1).await;
    assert_eq!(outcome.kind(), OutcomeKind::Conflict);
    job
}

/// Whichever result comes first, the wrong machine is fenced off, the job has the right records, and a restart keeps both.
#[tokio::test]
async fn coordinator_replaces_wrong_records() {
    let (honest, liar) = (("honest", 0.0), ("liar", 0.5));
    for (first, second) in [(honest, liar), (liar, honest)] {
        let (mut farm, _, dir) = begun(0.0).await;
        let job = contradicted(&farm, first, second).await;
        settled(&farm).await;
        for restarted in [false, true] {
            if restarted {
                farm.close().await;
                drop(farm);
                farm = load(open(&dir).await, 0.0).await;
            }
            assert_eq!((jobs_done(&farm), farm.status(&name()).unwrap().jobs_disputed), (1, 0));
            assert_eq!(value_of(&farm, &name(), job).await, value(job));
            assert!(is_fenced(&farm, "liar").await && !is_fenced(&farm, "honest").await);
            let found = farm.inspect(false).await;
            assert_eq!((found.records, found.damaged.len()), (2, 0), "{found:?}");
        }
    }
}

/// Wrong results on which all workers agree are found if they are sampled.
#[tokio::test]
async fn collusion_is_found_by_the_sample() {
    let (farm, _, _dir) = begun(1.0).await;
    let (one, other) = (worker(&farm, "one").await, worker(&farm, "other").await);
    let lease = lease(&farm, &one).unwrap();
    let job = lease.key.job;
    deliver(&farm, &one, &lease, 0.75).await;
    settled(&farm).await;
    let late = deliver(&farm, &other, &lease, 0.75).await;
    assert_eq!(late.kind(), OutcomeKind::Conflict);
    settled(&farm).await;
    assert!(is_fenced(&farm, "one").await && is_fenced(&farm, "other").await);
    assert_eq!(value_of(&farm, &name(), job).await, value(job));
}

/// A dispute that the coordinator could not settle is visible, and settled after a restart.
#[tokio::test]
async fn dispute_is_settled_after_a_restart() {
    let (dir, store) = store().await;
    let cannot = |_: &JobSpec| Err("no memory".to_owned());
    let farm = load_with(store, &Config { check_share: 0.0, recompute: cannot, ..Config::new("") }).await;
    farm.submit(&Actor::default(), name(), grid(), 0).await.unwrap();
    let job = contradicted(&farm, ("liar", 0.5), ("honest", 0.0)).await;
    farm.scheduler.settled().await;
    assert_eq!(farm.status(&name()).unwrap().jobs_disputed, 1);
    assert!(farm.explain(&name()).unwrap().iter().any(|reason| reason.code == "DISPUTED"));
    assert_eq!(value_of(&farm, &name(), job).await, value(job) + 0.5, "nothing is lost meanwhile");
    farm.close().await;
    drop(farm);
    let farm = load(open(&dir).await, 0.0).await;
    settled(&farm).await;
    assert_eq!(value_of(&farm, &name(), job).await, value(job));
    assert!(is_fenced(&farm, "liar").await);
}

/// If records of two dictionaries for the same walks differ, the wrong ones are replaced and their machine is fenced off,
/// whichever came first.
#[tokio::test]
async fn conflicting_shared_records_are_settled() {
    for wrong_first in [true, false] {
        let (farm, _, _dir) = begun(0.0).await;
        let other = testing::name("other");
        let sigma_t: Vec<f64> = (1..=JOBS).map(f64::from).collect();
        let overlapping = testing::grid(Some(PIXELS as u32), &sigma_t, &[0.9, 0.95], 5000);
        let [honest, liar] = [worker(&farm, "honest").await, worker(&farm, "liar").await];
        let (first, second) = if wrong_first { (&liar, &honest) } else { (&honest, &liar) };
        let number = |worker: &WorkerId, job| value(job) + if *worker == liar { 0.5 } else { 0.0 };
        let one = lease(&farm, first).unwrap();
        let job = one.key.job;
        deliver(&farm, first, &one, number(first, job)).await;
        farm.submit(&Actor::default(), other.clone(), overlapping, 9).await.unwrap();
        let same = lease(&farm, second).unwrap();
        assert_eq!(same.key.job, job);
        assert_eq!(deliver(&farm, second, &same, number(second, job)).await, Outcome::Differs);
        settled(&farm).await;
        assert!(is_fenced(&farm, "liar").await && !is_fenced(&farm, "honest").await);
        assert_eq!(value_of(&farm, &other, job).await, value(job));
        assert_eq!(jobs_done(&farm), u32::from(!wrong_first), "wrong records are gone, right ones stay");
    }
}
