//! Sixty-four workers, each a process, that join, leave and die while a dictionary is computed.

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{LONG, Process, SOON, wait_for};
use farm_tests::statistics::effort;
use tokio::time::Instant;

const WORKERS: usize = 64;
/// 408 jobs of some hundredths of a second.
const GRID: &str = "\
sigma_t_per_mm = [1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 20, 24, 30]
albedo = [0.5, 0.9]
g = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
thickness_mm = [0.25, 0.5, 1.0]
walks = 5000
";

struct Crowd<'f> {
    farm: &'f Farm,
    workers: Vec<Process>,
    joined: usize,
}

impl<'f> Crowd<'f> {
    fn of(farm: &'f Farm, size: usize) -> Self {
        let mut crowd = Self { farm, workers: Vec::new(), joined: 0 };
        crowd.fill(size);
        crowd
    }

    /// Starts workers until there are `size`.
    fn fill(&mut self, size: usize) {
        while self.workers.len() < size {
            let label = format!("crowd-{}", self.joined);
            self.workers.push(self.farm.worker(&label, &[]));
            self.joined += 1;
        }
    }

    /// Kills eight workers and terminates eight others, which exit with code 0.
    fn thin(&mut self) {
        for mut killed in self.workers.drain(..8) {
            killed.kill();
        }
        for mut leaving in self.workers.drain(..8) {
            assert_eq!(leaving.terminate(LONG), 0, "{}", leaving.log());
        }
    }

    fn end(self) {
        for mut worker in self.workers {
            assert_eq!(worker.terminate(LONG), 0, "{}", worker.log());
        }
    }
}

/// 64 workers join, leave and are killed.
#[tokio::test(flavor = "multi_thread")]
async fn changing_crowd_stores_each_record_once() {
    let mut farm = Farm::start(&["--lease", "3"]);
    let start = Instant::now();
    let mut crowd = Crowd::of(&farm, WORKERS);
    // Killed workers are listed as silent for a while.
    let connected = || {
        let workers = farm.ask(&["workers"])["workers"].take();
        workers.as_array().unwrap().iter().filter(|worker| worker["state"] != "silent").count()
    };
    wait_for("all are in", LONG, || (connected() >= WORKERS).then_some(()));
    println!("{WORKERS} processes registered after {:.1?}", start.elapsed());

    let rounds = 2 * effort();
    for round in 0..rounds {
        let name = format!("round-{round}");
        let grid = format!("{GRID}seed = {}\n", round + 1);
        let begun = Instant::now();
        farm.submit(&name, &grid);
        wait_for("a third is done", LONG, || (farm.show(&name)["jobs_done"].as_u64()? >= 140).then_some(()));
        crowd.thin();
        crowd.fill(WORKERS);
        assert_eq!(farm.done(&name), undisturbed(&grid), "{name}");
        println!("{name}: {:.1?}", begun.elapsed());
    }
    let (rows, repeated) = farm.record_rows().await;
    assert_eq!((rows, repeated), (rounds * 17 * 8 * 3 * 2, 0));
    assert!(farm.events("JOB_FAILED").is_empty(), "jobs are not blamed for killed workers");
    crowd.end();
    wait_for("all have left", SOON, || (connected() == 0).then_some(()));
    assert_eq!(farm.stop_coordinator(), 0);
}
