//! A database file that is moved or deleted while a farm uses it.

use std::fs::rename;

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{Process, SOON, farmctl, wait_for};

use super::{GRID, LONG_JOBS, SHORT_PACE};

/// A data folder that is moved away stops the coordinator.
#[test]
fn moved_folder_stops_the_coordinator() {
    let mut farm = Farm::start(&[]);
    farm.submit("grid", GRID);
    let mut worker = farm.worker("worker", &SHORT_PACE);
    worker.wait_for_log("job begins");
    let [data, away] = ["data", "away"].map(|name| farm.folder().join(name));
    rename(&data, &away).unwrap();
    let (code, log) = farm.coordinator_ends();
    assert_eq!(code, 1, "{log}");
    assert!(log.contains("deleted, moved or replaced"), "{log}");
    rename(&away, &data).unwrap();
    farm.start_coordinator();
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert_eq!(worker.terminate(SOON), 0);
}

/// A command fails if the farm that it started was deleted.
#[test]
fn command_fails_if_its_farm_is_deleted() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("grid.toml"), LONG_JOBS).unwrap();
    let mut command = farmctl(folder.path());
    let log = folder.path().join("log");
    let mut submit =
        Process::spawn("farmctl", command.args(["submit", "grid.toml"]).env("FARM_PACE_MS", "60000"), &log);
    let data = folder.path().join("farm-data");
    wait_for("the farm serves", SOON, || data.join("coordinator.addr").exists().then_some(()));
    rename(&data, folder.path().join("deleted")).unwrap();
    assert_eq!(submit.exit_within(2 * SOON), 1);
    assert!(submit.log().contains("deleted, moved or replaced"), "{}", submit.log());
}
