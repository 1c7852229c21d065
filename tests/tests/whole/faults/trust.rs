//! A worker whose records are wrong.

use farm_tests::farm::Farm;
use farm_tests::grids::{grid_of, traced, undisturbed};
use farm_tests::process::{LONG, SOON, wait_for};
use farm_tests::test_worker::{TestWorker, falsified};
use tonic::Code;

use super::{GRID, JOBS};

async fn refused(farm: &Farm, liar: &mut TestWorker) {
    let acquired = liar.acquire(1).await.unwrap_err();
    assert!(matches!(acquired.code(), Code::PermissionDenied | Code::Aborted), "{acquired}");
    // Another process with the same token is refused too.
    for name in ["liar", "another"] {
        let registered = farm.test_worker_with("liar", name).await.map(drop).unwrap_err();
        assert_eq!(registered.code(), Code::PermissionDenied, "{registered}");
        assert!(registered.message().contains("others agree against it"), "{registered}");
    }
}

/// The jobs of the worker are computed again, and it stays fenced over a restart.
#[tokio::test(flavor = "multi_thread")]
async fn worker_with_wrong_records_is_fenced() {
    let mut farm = Farm::with_tokens(&["liar", "a", "b"], &["--lease", "2", "--verify-share", "1"]);
    farm.submit("grid", GRID);
    let grid = grid_of(GRID);
    let mut liar = farm.test_worker_with("liar", "liar").await.unwrap();
    for lease in liar.acquire(3).await.unwrap() {
        let records = falsified(&traced(&grid, lease.key.job as usize));
        liar.complete(&lease, records).await.unwrap();
    }
    let honest = [farm.worker_of("a"), farm.worker_of("b")];
    let fenced = wait_for("the liar is fenced off", LONG, || farm.events("WORKER_FENCED").pop());
    assert_eq!(fenced["worker"], "liar");
    assert_eq!(liar.acquire(1).await.unwrap_err().code(), Code::PermissionDenied);
    refused(&farm, &mut liar).await;
    // Every result is compared, including those that were computed again.
    wait_for("all is compared", LONG, || {
        let status = farm.ask(&["status"]);
        let agreed = status["checks_agreed"].as_u64()? >= JOBS;
        (agreed && status["dictionaries"][0]["state"] == "done").then_some(())
    });
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert_eq!(farm.events("WORKER_FENCED").len(), 1, "the honest workers are not fenced off");
    assert_eq!(farm.stop_coordinator(), 0);
    farm.start_coordinator();
    wait_for("the honest ones are back", SOON, || {
        (farm.ask(&["workers"])["workers"].as_array()?.len() == 2).then_some(())
    });
    refused(&farm, &mut liar).await;
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    let unknown = farm.farmctl(&["workers", "readmit", "unknown"]);
    assert_eq!(unknown.code, 1, "{}", unknown.stdout);
    assert!(unknown.stderr.contains("liar@127.0.0.1 (liar)"), "{}", unknown.stderr);
    farm.ask(&["workers", "readmit", "liar@127.0.0.1"]);
    farm.test_worker_with("liar", "liar").await.unwrap();
    assert_eq!(farm.done("grid"), undisturbed(GRID), "recomputed records are kept");
    drop(honest);
}
