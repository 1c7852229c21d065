//! `kill -9` of a farm inside `farmctl` at random moments: nothing is lost, and the final records are the same bytes.
//! Faults of separate processes are in `faults`.
//!
//! SIGKILL tests that unwritten data of a process are not needed; it does not test that data survive a power cut.
//! Rounds: 6 by default, more with `FARM_TEST_EFFORT=20`, which multiplies them.

#![expect(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "a test may panic, and this one waits in real time"
)]

use std::path::Path;
use std::time::Instant;

use farm_tests::process::{Process, farmctl, program, run};
use farm_tests::statistics::effort;

const GRID: &str = "\
sigma_t_per_mm = [1, 2, 4, 8, 16, 24]
albedo = [0.5, 0.9, 0.99]
g = [0.0, 0.4]
walks = 800000
";

fn rounds() -> u64 {
    6 * effort()
}

/// Moments from 0 to 1 that differ from round to round.
fn moment(round: u64) -> f64 {
    (round as f64 * 0.618_034 + 0.31).fract()
}

fn folder_with_grid() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("grid.toml"), GRID).unwrap();
    folder
}

/// The digest from `show` and the bytes that `export` writes.
fn result(folder: &Path) -> (String, String) {
    let shown = run(folder, &["show", "grid", "--json"]);
    let shown: serde_json::Value = serde_json::from_str(&shown.stdout).expect("show --json prints JSON");
    let digest = shown["data"]["records_digest"].as_str().expect("the dictionary is complete").to_owned();
    (digest, run(folder, &["export", "grid"]).stdout)
}

/// No record is lost by a kill of farmctl.
#[test]
fn repeatedly_killed_farm_has_the_same_bytes() {
    program("farmctl");
    let undisturbed = folder_with_grid();
    let start = Instant::now();
    assert_eq!(run(undisturbed.path(), &["submit", "grid.toml", "-q"]).code, 0);
    let whole = start.elapsed();
    let expected = result(undisturbed.path());
    assert!(expected.1.lines().count() == 1 + 72 * 3 * 360, "the export holds every pixel of every record");

    let killed = folder_with_grid();
    let (mut interrupted, mut in_the_middle, mut stored) = (0, 0, 0);
    for round in 0..rounds() {
        let mut submit = farmctl(killed.path());
        submit.args(["submit", "grid.toml", "-q"]);
        let mut submit = Process::spawn("farmctl", &mut submit, &killed.path().join("farmctl.log"));
        std::thread::sleep(whole.mul_f64(0.5 * moment(round)));
        interrupted += u32::from(submit.is_running());
        submit.kill();
        let now = records_done(killed.path()).unwrap_or(0);
        assert!(now >= stored, "{stored} records were stored, {now} are left after a kill");
        in_the_middle += u32::from(now > 0 && now < 72);
        stored = now;
    }
    assert!(interrupted > 1 && in_the_middle > 0, "kills must hit running work");
    let last = run(killed.path(), &["submit", "grid.toml", "-q"]);
    assert_eq!(last.code, 0, "{}", last.stderr);
    assert!(result(killed.path()) == expected, "the bytes differ from the undisturbed run's");
}

/// Number of records of a farm; None without a farm.
fn records_done(folder: &Path) -> Option<u64> {
    let list = run(folder, &["list", "--json"]);
    let list: serde_json::Value = serde_json::from_str(&list.stdout).ok()?;
    list["data"]["dictionaries"][0]["records_done"].as_u64()
}
