//! A temporary absence of the coordinator.

use std::collections::BTreeSet;
use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{Process, SOON, Signal, wait_for};

use super::{SHORT_PACE, short_or_long};

/// 24 jobs: more than one worker does until the other comes back.
const GRID: &str = "\
sigma_t_per_mm = [6, 7, 8, 9]
albedo = [0.5, 0.99]
g = [0.0, 0.2, 0.4]
walks = 5000
";
const JOBS: u64 = 24;

/// The leased jobs of the workers are not computed twice, except for copies of a late one that the coordinator grants
/// at the end, when nothing else waits.
#[test]
fn workers_survive_an_absence_of_the_coordinator() {
    let mut farm = Farm::start(&["--verify-share", "0", "--lease", "60"]);
    farm.submit("grid", GRID);
    let mut workers = [farm.worker("a", &SHORT_PACE), farm.worker("b", &SHORT_PACE)];
    farm.leased("grid", 2);
    assert_eq!(farm.stop_coordinator(), 0);
    std::thread::sleep(short_or_long(Duration::from_secs(3), Duration::from_mins(1)));
    assert!(workers.iter_mut().all(Process::is_running));
    farm.start_coordinator();
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    // Workers log the outcome of each result: a job that was traced twice is a duplicate or a lost lease.
    let logs = farm.worker_logs();
    let jobs = |text: &str| {
        let lines = logs.iter().filter(|line| line.to_string().contains(text));
        lines.map(|line| line["fields"]["job"].as_u64().expect("a job")).collect::<BTreeSet<_>>()
    };
    assert_eq!(jobs("job done").len() as u64, JOBS);
    let twice = &jobs("were stored before") | &jobs("lease lost");
    let copies = farm.figure(r#"farm_leases_granted_total{kind="speculative"}"#);
    assert!(twice.len() as u64 <= copies, "{twice:?} computed twice, {copies} copies granted");
}

/// Lines above debug level in a worker's log that contain `what`.
fn lines(worker: &Process, what: &str) -> Vec<String> {
    let lines = worker.log();
    let line = |line: &&str| !line.contains(r#""level":"DEBUG""#) && line.contains(what);
    lines.lines().filter(line).map(ToOwned::to_owned).collect()
}

/// The changes are joining, losing, finding and leaving the coordinator.
#[test]
fn worker_logs_each_connection_change_once() {
    let mut farm = Farm::start(&["--lease", "2"]);
    let mut worker = farm.worker("worker", &[]);
    let url = farm.url();
    let wait_for_line = |worker: &Process, what: &str| {
        let line = format!("{what} the coordinator at {url}");
        wait_for(&line, SOON, || (!lines(worker, &line).is_empty()).then_some(()));
    };
    wait_for_line(&worker, "joined");
    assert_eq!(farm.stop_coordinator(), 0);
    wait_for_line(&worker, "lost");
    // Several calls fail meanwhile.
    std::thread::sleep(Duration::from_secs(2));
    farm.start_coordinator();
    wait_for_line(&worker, "found");
    worker.signal(Signal::TERM);
    assert_eq!(worker.exit_within(SOON), 0);
    for what in ["joined", "lost", "found", "left"] {
        let logged = lines(&worker, &format!("{what} the coordinator at {url}"));
        assert_eq!(logged.len(), 1, "{}", worker.log());
    }
    assert!(lines(&worker, "heartbeat").is_empty(), "{}", worker.log());
}
