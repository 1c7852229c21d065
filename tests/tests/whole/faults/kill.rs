//! `kill -9` of random processes at random moments, from a seed.
//!
//! SIGKILL tests that unwritten data of a process are not needed; it does not test that data survive a power cut.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{Process, SOON, farmctl, run, wait_for};
use farm_tests::statistics::{Normal, effort};

use super::{JOBS, RECORDS, SHORT_PACE};

const SEED: u64 = 20_261_121;
/// Longest time between two kills.
const PAUSE: Duration = Duration::from_millis(600);

/// 12 in the short form, up to 200 in the long form.
fn rounds() -> u64 {
    (12 * effort()).min(200)
}

/// The grid of a dictionary, with records that no other has.
fn grid(number: u64) -> String {
    format!("{}seed = {number}\n", super::GRID)
}

fn name(number: u64) -> String {
    format!("grid-{number}")
}

fn records_done(farm: &Farm, number: u64) -> u64 {
    let listed = wait_for("the coordinator answers after a kill", SOON, || farm.listed(&name(number)));
    listed["records_done"].as_u64().unwrap()
}

/// Results that were acknowledged as stored, by dictionary and job. Workers log this when they receive the answer.
fn acknowledged(farm: &Farm) -> BTreeMap<(u64, u64), u64> {
    let mut counts = BTreeMap::new();
    for line in farm.worker_logs() {
        let text = line.to_string();
        if text.contains("job done") {
            let field = |name: &str| find_number(&line, name).expect("the line has this field");
            *counts.entry((field("dictionary"), field("job"))).or_default() += 1;
        }
    }
    counts
}

/// A field of a log line, wherever the format puts it.
fn find_number(line: &serde_json::Value, name: &str) -> Option<u64> {
    line[name].as_u64().or_else(|| line["fields"][name].as_u64())
}

/// Each acknowledged record exists exactly once.
#[test]
fn acknowledged_records_survive_random_kills() {
    // Killed workers count as silent: no job should be given up because of that.
    let mut farm = Farm::start(&["--lease", "1", "--max-attempts", "1000", "--verify-share", "0"]);
    let mut random = Normal::new(SEED);
    let mut started = 0;
    let mut worker = |farm: &Farm| {
        started += 1;
        farm.worker(&format!("w{started}"), &SHORT_PACE)
    };
    let mut workers: [Process; 2] = [worker(&farm), worker(&farm)];
    let (mut number, mut stored, mut kills) = (1, 0, [0, 0]);
    farm.submit(&name(number), &grid(number));
    for _ in 0..rounds() {
        std::thread::sleep(PAUSE.mul_f64(random.uniform()));
        match (random.uniform() * 3.0) as usize {
            0 => {
                farm.kill_coordinator();
                farm.start_coordinator();
                kills[0] += 1;
            }
            victim => {
                workers[victim - 1].kill();
                workers[victim - 1] = worker(&farm);
                kills[1] += 1;
            }
        }
        let now = records_done(&farm, number);
        assert!(now >= stored, "{stored} records were stored, {now} are left after a kill");
        stored = now;
        // Kills must hit running work to be meaningful.
        if now == RECORDS {
            (number, stored) = (number + 1, 0);
            farm.submit(&name(number), &grid(number));
        }
    }
    assert!(kills.iter().all(|k| *k > 0), "both kinds must be killed: {kills:?}");
    let digests: Vec<_> = (1..=number).map(|n| farm.done(&name(n))).collect();
    assert_eq!(farm.stop_coordinator(), 0);
    check_rows(&farm, number);
    let acknowledged = acknowledged(&farm);
    let lost: Vec<_> = acknowledged.iter().filter(|(_, times)| **times > 1).collect();
    assert!(lost.is_empty(), "stored, acknowledged, lost and stored again: {lost:?}");
    assert!(acknowledged.len() as u64 >= JOBS / 2, "workers log acknowledged results");
    for (n, digest) in (1..).zip(digests) {
        assert_eq!(digest, undisturbed(&grid(n)), "the bytes differ from the undisturbed run's");
    }
    println!("{} kills of the coordinator, {} of workers, {number} dictionaries", kills[0], kills[1]);
}

fn check_rows(farm: &Farm, dictionaries: u64) {
    let (rows, doubled) = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap()
        .block_on(farm.record_rows());
    assert_eq!((rows, doubled), (dictionaries * RECORDS, 0));
}

/// Records of the only dictionary of a folder; None without one.
fn records_of_folder(folder: &Path) -> Option<u64> {
    let list: serde_json::Value = serde_json::from_str(&run(folder, &["list", "--json"]).stdout).ok()?;
    list["data"]["dictionaries"][0]["records_done"].as_u64()
}

/// A farm inside `farmctl` continues after each kill: no record is lost, and the bytes are those of the tracer.
#[test]
fn killed_local_farm_continues() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("grid.toml"), super::GRID).unwrap();
    let submit = |pace_ms: &str| {
        let mut command = farmctl(folder.path());
        command.args(["submit", "grid.toml", "-q"]).env("FARM_PACE_MS", pace_ms);
        Process::spawn("farmctl", &mut command, &folder.path().join("farmctl.log"))
    };
    let mut random = Normal::new(SEED);
    let (mut stored, mut in_the_middle) = (0, 0);
    for _ in 0..rounds() / 2 {
        let mut command = submit("400");
        // From the start of the program to its second jobs.
        std::thread::sleep(PAUSE.mul_f64(1.5 * random.uniform()));
        in_the_middle += u32::from(command.is_running());
        command.kill();
        let now = records_of_folder(folder.path()).unwrap_or(0);
        assert!(now >= stored, "{stored} records were stored, {now} are left after a kill");
        stored = now;
    }
    assert!(in_the_middle > 1, "kills must hit running work");
    assert_eq!(submit("0").exit_within(SOON), 0);
    let shown: serde_json::Value =
        serde_json::from_str(&run(folder.path(), &["show", "grid", "--json"]).stdout).unwrap();
    assert_eq!(shown["data"]["records_digest"], undisturbed(super::GRID));
    let lines = run(folder.path(), &["export", "grid"]).stdout.lines().count() as u64;
    assert_eq!(lines, 1 + RECORDS * 3 * 360, "the export has every pixel of every record");
}
