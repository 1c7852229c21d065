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
        assert!(registered.message().contains("the coordinator has computed others"), "{registered}");
    }
}

/// The jobs of the worker are computed again, and it stays fenced over a restart.
#[tokio::test(flavor = "multi_thread")]
async fn worker_with_wrong_records_is_fenced() {
    let mut farm = Farm::with_tokens(&["liar", "honest"], &["--lease", "2", "--verify-share", "1"]);
    farm.submit("grid", GRID);
    let grid = grid_of(GRID);
    let mut liar = farm.test_worker_with("liar", "liar").await.unwrap();
    for lease in liar.acquire(3).await.unwrap() {
        let records = falsified(&traced(&grid, lease.key.job as usize));
        liar.complete(&lease, records).await.unwrap();
    }
    let honest = farm.worker_of("honest");
    let fenced = wait_for("the liar is fenced off", LONG, || farm.events("WORKER_FENCED").pop());
    assert_eq!(fenced["worker"], "liar");
    assert_eq!(liar.acquire(1).await.unwrap_err().code(), Code::PermissionDenied);
    refused(&farm, &mut liar).await;
    // Every result is compared, including those that were computed again; one is the coordinator's own.
    wait_for("all is compared", LONG, || {
        let status = farm.ask(&["status"]);
        let agreed = status["checks_agreed"].as_u64()? >= JOBS - 1;
        (agreed && status["dictionaries"][0]["state"] == "done").then_some(())
    });
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert_eq!(farm.events("WORKER_FENCED").len(), 1, "the honest worker is not fenced off");
    assert_eq!(farm.stop_coordinator(), 0);
    farm.start_coordinator();
    wait_for("the honest one is back", SOON, || {
        (farm.ask(&["workers"])["workers"].as_array()?.len() == 1).then_some(())
    });
    refused(&farm, &mut liar).await;
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    farm.let_in("worker", "cured");
    wait_for("a new token lets it in", SOON, || {
        let registered = tokio::task::block_in_place(|| {
            tokio::runtime::Handle::current().block_on(farm.test_worker_with("cured", "cured"))
        });
        registered.is_ok().then_some(())
    });
    drop(honest);
}
