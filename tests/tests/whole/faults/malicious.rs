//! A malicious owner of a worker token.

use farm_proto::ids::Token;
use farm_proto::lease::{Lease, LeaseKey};
use farm_proto::wire::CompletionKind;
use farm_tests::farm::Farm;
use farm_tests::grids::{grid_of, traced, undisturbed};
use farm_tests::process::{LONG, SOON, wait_for};
use farm_tests::test_worker::{falsified, on_wire, with_number};
use tonic::Code;

use super::{GRID, JOBS, RECORDS};

/// With two machines, of which one delivers wrong records first and the other contradicts it, the wrong one is fenced off.
/// The coordinator's records take the place of the wrong ones, and all of that outlasts a restart.
#[tokio::test(flavor = "multi_thread")]
async fn coordinator_decides_between_two_machines() {
    let mut farm = Farm::with_tokens(&["honest", "liar"], &["--lease", "2", "--verify-share", "0"]);
    farm.submit("grid", GRID);
    let grid = grid_of(GRID);
    let mut honest = farm.test_worker_with("honest", "honest").await.unwrap();
    let late = honest.acquire(3).await.unwrap();
    let is_late = |lease: &Lease| late.iter().any(|own| own.key.job == lease.key.job);
    let mut liar = farm.test_worker_with("liar", "liar").await.unwrap();
    let mut wrong = Vec::new();
    while wrong.len() < late.len() {
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
        wrong.extend(liar.acquire(JOBS as u32).await.unwrap().into_iter().filter(is_late));
    }
    for lease in &wrong {
        let records = falsified(&traced(&grid, lease.key.job as usize));
        assert_eq!(liar.complete(lease, records).await.unwrap(), CompletionKind::Stored);
    }
    let records = on_wire(&traced(&grid, late[0].key.job as usize));
    assert_eq!(honest.complete(&late[0], records).await.unwrap(), CompletionKind::Conflict);
    let fenced = wait_for("the liar is fenced", LONG, || farm.events("WORKER_FENCED").pop());
    assert_eq!(fenced["worker"], "liar");
    wait_for("no dispute is left", LONG, || (farm.listed("grid")?["jobs_disputed"] == 0).then_some(()));
    assert_eq!(farm.listed("grid").unwrap()["jobs_done"], 1, "the other wrong records are computed again");
    farm.kill_coordinator();
    farm.start_coordinator();
    assert!(farm.test_worker_with("liar", "again").await.is_err(), "it stays outside");
    let worker = farm.worker_of("honest");
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert_eq!(farm.record_rows().await, (RECORDS, 0));
    assert_eq!(farm.events("WORKER_FENCED").len(), 1);
    drop(worker);
}

/// Results without a lease that was granted are refused.
#[tokio::test(flavor = "multi_thread")]
async fn results_without_a_real_lease_are_refused() {
    let farm = Farm::with_tokens(&["liar", "honest"], &["--lease", "2"]);
    farm.submit("grid", GRID);
    let mut liar = farm.test_worker_with("liar", "liar").await.unwrap();
    let lease = liar.acquire(1).await.unwrap().remove(0);
    let grid = grid_of(GRID);
    let records = on_wire(&traced(&grid, lease.key.job as usize));
    for key in [
        LeaseKey { token: Token(lease.key.token.0 ^ 1), ..lease.key },
        LeaseKey { token: Token(1 << 64), attempt: 7, ..lease.key },
    ] {
        let forged = Lease { key, ..lease.clone() };
        assert_eq!(liar.complete(&forged, records.clone()).await.unwrap(), CompletionKind::Refused);
        assert!(!liar.renew(&forged, true).await.unwrap(), "it is not renewed either");
    }
    // The lease of another worker is not accepted either.
    let mut other = farm.test_worker_with("honest", "honest").await.unwrap();
    assert_eq!(other.complete(&lease, records.clone()).await.unwrap(), CompletionKind::Refused);
    assert_eq!(liar.complete(&lease, records).await.unwrap(), CompletionKind::Stored);
}

/// A machine that fails at once or delivers NaN is suspended.
#[tokio::test(flavor = "multi_thread")]
async fn failing_machine_costs_no_job() {
    let farm = Farm::with_tokens(&["hole", "healthy"], &["--lease", "3600", "--verify-share", "0"]);
    farm.submit("grid", GRID);
    let mut hole = farm.test_worker_with("hole", "hole").await.unwrap();
    let healthy = farm.test_worker_with("healthy", "healthy").await.unwrap();
    let grid = grid_of(GRID);
    let mut failed = 0;
    for lease in hole.acquire(1).await.unwrap() {
        let records = with_number(&on_wire(&traced(&grid, lease.key.job as usize)), 0, f32::NAN);
        assert!(hole.complete(&lease, records).await.is_err());
        failed += 1;
    }
    while let Some(lease) = hole.acquire(1).await.unwrap().pop() {
        hole.fail(&lease, "no such file or directory").await.unwrap();
        failed += 1;
    }
    assert_eq!(failed, 3, "it does not get the whole dictionary");
    let workers = farm.ask(&["workers"])["workers"].take();
    let listed = workers.as_array().unwrap().iter().find(|w| w["label"] == "hole").unwrap();
    assert_eq!(listed["state"], "suspended", "{listed}");
    assert!(farm.farmctl(&["workers"]).stdout.contains("suspended for "));
    let suspended = wait_for("the event", SOON, || farm.events("WORKER_SUSPENDED").pop());
    assert!(suspended["message"].as_str().unwrap().contains("no such file"), "{suspended}");
    healthy.leave().await.unwrap();
    let worker = farm.worker_of("healthy");
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert!(farm.events("JOB_FAILED").is_empty());
    drop(worker);
}

/// The list of workers shows ids to all users.
#[tokio::test(flavor = "multi_thread")]
async fn worker_id_alone_grants_nothing() {
    let farm = Farm::with_tokens(&["honest", "liar"], &[]);
    farm.submit("grid", GRID);
    let mut honest = farm.test_worker_with("honest", "honest").await.unwrap();
    let lease = honest.acquire(1).await.unwrap().remove(0);
    let read = farm.ask(&["workers"])["workers"][0]["worker_id"].as_str().unwrap().to_owned();
    let mut liar = farm.test_worker_with("liar", "liar").await.unwrap();
    let own_mac = liar.token.rsplit_once('.').unwrap().1.to_owned();
    for token in [read.clone(), format!("{read}.{own_mac}")] {
        liar.token = token;
        let records = on_wire(&traced(&grid_of(GRID), lease.key.job as usize));
        let codes = [
            liar.acquire(1).await.unwrap_err().code(),
            liar.renew(&lease, true).await.unwrap_err().code(),
            liar.complete(&lease, records).await.unwrap_err().code(),
            liar.fail(&lease, "no luck").await.unwrap_err().code(),
            liar.clone().leave().await.unwrap_err().code(),
        ];
        assert_eq!(codes, [Code::Aborted; 5], "{}", liar.token);
    }
    assert!(honest.renew(&lease, true).await.unwrap(), "its lease is still valid");
    assert!(farm.events("WORKER_LEFT").is_empty() && farm.events("ATTEMPT_FAILED").is_empty());
}
