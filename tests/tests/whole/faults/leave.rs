//! Workers that leave on request.

use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{Process, SOON, Signal, program, wait_for};
use tokio::time::Instant;

use super::{GRID, LONG_JOBS, LONG_PACE};

/// Leases that are not handed back stay blocked for longer than these tests.
const LEASE: [&str; 2] = ["--lease", "3600"];

fn leases(farm: &Farm) -> u64 {
    farm.show("grid")["jobs_leased"].as_u64().unwrap()
}

fn jobs_done(farm: &Farm) -> u64 {
    farm.show("grid")["jobs_done"].as_u64().unwrap()
}

fn assert_no_blame(farm: &Farm) {
    for kind in ["ATTEMPT_FAILED", "JOB_FAILED", "JOB_QUARANTINED"] {
        assert!(farm.events(kind).is_empty(), "{kind}");
    }
}

fn assert_all_handed_back(farm: &Farm) {
    assert_no_blame(farm);
    assert_eq!(leases(farm), 0, "all leases are handed back");
    assert_eq!(farm.figure("farm_leases_expired_total"), 0);
}

/// Leases of jobs that have not begun are handed back at once.
#[test]
fn stopping_worker_finishes_its_running_jobs() {
    let farm = Farm::start(&LEASE);
    farm.submit("grid", LONG_JOBS);
    let mut worker = farm.worker("worker", &[LONG_PACE, ["--grace", "60s"]].concat());
    // One is traced and the next waits: both are leased before the worker is stopped.
    farm.leased("grid", 2);
    worker.wait_for_log("job begins");
    worker.signal(Signal::TERM);
    wait_for("the waiting one is handed back", Duration::from_secs(2), || (leases(&farm) == 1).then_some(()));
    assert_eq!(jobs_done(&farm), 0, "the other is still being traced");
    assert_eq!(worker.exit_within(Duration::from_mins(1)), 0);
    assert_eq!(jobs_done(&farm), 1, "the traced result is stored");
    assert_all_handed_back(&farm);
    let second = farm.worker("second", &[]);
    assert_eq!(farm.done("grid"), undisturbed(LONG_JOBS));
    drop(second);
}

/// A worker gets a hang-up when its terminal is closed, or its connection is lost.
#[test]
fn worker_hands_back_on_hang_up() {
    let farm = Farm::start(&LEASE);
    farm.submit("grid", LONG_JOBS);
    let mut worker = farm.worker("worker", &[LONG_PACE, ["--grace", "0s"]].concat());
    worker.wait_for_log("job begins");
    worker.hang_up();
    assert_eq!(worker.exit_within(SOON), 0);
    assert_all_handed_back(&farm);
}

/// A coordinator ends in order when its terminal is closed.
#[test]
fn coordinator_ends_well_on_hang_up() {
    let mut farm = Farm::start(&[]);
    farm.coordinator().hang_up();
    wait_for("the coordinator ends", SOON, || (!farm.coordinator_runs()).then_some(()));
    assert!(farm.coordinator().log().contains("stopping"), "{}", farm.coordinator().log());
}

/// `nohup` starts programs that continue when the terminal is closed.
#[test]
fn ignored_hang_up_stays_ignored() {
    let farm = Farm::start(&LEASE);
    farm.submit("grid", GRID);
    let mut shell = std::process::Command::new("sh");
    shell
        .args(["-c", "trap '' HUP; exec \"$0\" --server \"$1\""])
        .arg(program("farm-worker"))
        .arg(farm.url());
    let worker = Process::spawn("worker", &mut shell, &farm.folder().join("worker.log"));
    worker.wait_for_log("joined");
    worker.signal(Signal::HUP);
    assert_eq!(farm.done("grid"), undisturbed(GRID));
}

/// A preempted host stops its worker, and kills it before the grace is over.
#[test]
fn worker_killed_while_stopping_is_not_blamed() {
    let farm = Farm::start(&["--lease", "2", "--max-attempts", "1"]);
    farm.submit("grid", LONG_JOBS);
    let mut worker = farm.worker("worker", &[LONG_PACE, ["--grace", "60s"]].concat());
    farm.leased("grid", 2);
    worker.wait_for_log("job begins");
    worker.signal(Signal::TERM);
    wait_for("the waiting one is handed back", SOON, || (leases(&farm) < 2).then_some(()));
    worker.kill();
    wait_for("the other lease expires", SOON, || (leases(&farm) == 0).then_some(()));
    assert_no_blame(&farm);
}

/// A worker ends before its time limit, and no job is blamed.
#[test]
fn time_limit_ends_a_worker_without_blame() {
    let farm = Farm::start(&LEASE);
    // More work than fits into the time.
    farm.submit("grid", &format!("{LONG_JOBS}sample_ior = [1.3, 1.4, 1.5, 1.6]\n"));
    let start = Instant::now();
    let mut worker = farm.worker("worker", &[LONG_PACE, ["--time-limit", "8s"], ["--grace", "1s"]].concat());
    assert_eq!(worker.exit_within(Duration::from_secs(8)), 0);
    let worked = start.elapsed();
    assert!(worked > Duration::from_secs(2), "it worked for {worked:?} only");
    assert!(worker.log().contains("the time limit is near"), "{}", worker.log());
    assert_all_handed_back(&farm);
}

/// A worker that is drained finishes its jobs and ends.
#[test]
fn drained_worker_finishes_its_jobs() {
    let farm = Farm::start(&["--lease", "4"]);
    farm.submit("grid", LONG_JOBS);
    let mut worker = farm.worker("old", &[LONG_PACE, ["--grace", "60s"]].concat());
    worker.wait_for_log("job begins");
    farm.ask(&["workers", "drain", "old"]);
    let second = farm.worker("young", &[]);
    assert_eq!(worker.exit_within(SOON * 2), 0);
    assert!(worker.log().contains("the coordinator requested it"), "{}", worker.log());
    assert_eq!(farm.done("grid"), undisturbed(LONG_JOBS));
    assert_all_handed_back(&farm);
    assert_eq!(farm.farmctl(&["workers", "drain", "old"]).code, 1, "it is no longer registered");
    drop(second);
}
