//! Network links that fail silently.

use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{LONG, SOON, Signal, wait_for};
use farm_tests::proxy::{Direction, Proxy};
use farm_tests::statistics::effort;

use super::{GRID, JOBS, LONG_JOBS, LONG_PACE, SHORT_PACE};

const RENEWED: &str = r#"farm_rpc_seconds_count{method="/farm.v1.Leases/Renew",code="OK"}"#;
const DUPLICATES: &str = r#"farm_jobs_completed_total{outcome="duplicate"}"#;
const CONFLICTS: &str = r#"farm_jobs_completed_total{outcome="conflict"}"#;

async fn proxy(farm: &Farm) -> Proxy {
    Proxy::start(([127, 0, 0, 1], farm.port()).into()).await
}

/// Waits until the worker has renewed its leases.
fn renewed(farm: &Farm) {
    let before = farm.figure(RENEWED);
    wait_for("leases are renewed", SOON, || (farm.figure(RENEWED) > before + 2).then_some(()));
}

/// No job is blamed twice.
#[tokio::test(flavor = "multi_thread")]
async fn paused_worker_delivers_duplicates() {
    let farm = Farm::start(&["--insecure", "--lease", "1"]);
    let link = proxy(&farm).await;
    farm.submit("grid", LONG_JOBS);
    let stopped = farm.worker_at(&link.url(), "stopped", &LONG_PACE);
    farm.leased("grid", 1);
    renewed(&farm);
    link.hold(Direction::Requests);
    stopped.signal(Signal::STOP);
    let other = farm.worker("other", &[]);
    assert_eq!(farm.done("grid"), undisturbed(LONG_JOBS));
    // It continues where it stopped; its result is held until it is certainly late.
    let before = link.held_bytes();
    stopped.signal(Signal::CONT);
    wait_for("the late result", LONG, || (link.held_bytes() > before + 20_000).then_some(()));
    link.heal();
    wait_for("the duplicate", SOON, || (farm.figure(DUPLICATES) > 0).then_some(()));
    assert_eq!(farm.figure(CONFLICTS), 0);
    let mut blamed: Vec<_> =
        farm.events("ATTEMPT_FAILED").iter().map(|e| e["job"].as_u64().unwrap()).collect();
    let all = blamed.len();
    assert!(
        (1..=2).contains(&all),
        "silence during computation is reported once per job: {:?}",
        farm.ask(&["events", "-n", "50"])
    );
    blamed.dedup();
    assert_eq!(blamed.len(), all, "a job was blamed twice");
    assert!(farm.events("JOB_QUARANTINED").is_empty());
    assert_eq!(farm.show("grid")["records_digest"], undisturbed(LONG_JOBS));
    drop((stopped, other));
}

/// The connection is dead as when a router has lost its state: it never heals, without an error, and new ones pass.
#[tokio::test(flavor = "multi_thread")]
async fn worker_leaves_a_silently_dead_connection() {
    if effort() == 1 {
        eprintln!("skipped in the short form: pings take 40 s to find a dead connection");
        return;
    }
    let farm = Farm::start(&["--insecure", "--lease", "1"]);
    let link = proxy(&farm).await;
    farm.submit("grid", GRID);
    let worker = farm.worker_at(&link.url(), "worker", &SHORT_PACE);
    farm.leased("grid", 1);
    link.freeze();
    let before = link.accepted();
    // Twice 20 s, and a pause between two attempts.
    wait_for("a new connection", Duration::from_secs(55), || (link.accepted() > before).then_some(()));
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    drop(worker);
}

/// Results pass a link that breaks off again and again.
#[tokio::test(flavor = "multi_thread")]
async fn results_pass_a_link_that_keeps_breaking() {
    let farm = Farm::start(&["--insecure", "--lease", "2", "--max-attempts", "1000"]);
    let link = proxy(&farm).await;
    farm.submit("grid", GRID);
    let worker = farm.worker_at(&link.url(), "worker", &SHORT_PACE);
    for bytes in [60_000, 20_000, 5_000, 100] {
        // Heartbeats, too, are held when this many bytes have passed.
        link.hold_after(Direction::Requests, bytes);
        wait_for("the link breaks off", LONG, || (link.held_bytes() > 0).then_some(()));
        link.cut();
        link.heal();
    }
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert!(farm.figure(r#"farm_jobs_completed_total{outcome="stored"}"#) == JOBS);
    drop(worker);
}
