//! A coordinator that is away for a while.

use std::time::Duration;

use farm_tests::farm_processes::{FarmProcesses, undisturbed};

use super::short_or_long;

/// 24 jobs of some tenths of a second: more than one worker does in the time in which the other comes back.
const GRID: &str = "\
sigma_t_per_mm = [6, 7, 8, 9]
albedo = [0.5, 0.99]
g = [0.0, 0.2, 0.4]
walks = 300000
";
const JOBS: u64 = 24;

#[test]
fn workers_outlive_an_absence_and_nothing_in_hand_is_computed_twice() {
    let mut farm = FarmProcesses::start(&["--verify-share", "0", "--lease", "8"]);
    farm.submit("grid", GRID);
    let mut workers = [farm.worker("a", &[]), farm.worker("b", &[])];
    farm.leased("grid", 2);
    assert_eq!(farm.stop_coordinator(), 0);
    std::thread::sleep(short_or_long(Duration::from_secs(3), Duration::from_mins(1)));
    assert!(workers.iter_mut().all(farm_tests::farm_processes::Process::is_running));
    farm.start_coordinator();
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    // Workers write down what became of each result: traced twice would be a duplicate, or a lease that was lost.
    let told = |text: &str| farm.worker_logs().iter().filter(|l| l.to_string().contains(text)).count() as u64;
    let (stored, twice, lost) = (told("job done"), told("were stored before"), told("lease lost"));
    assert_eq!((stored, twice, lost), (JOBS, 0, 0), "stored, computed twice, dropped");
}
