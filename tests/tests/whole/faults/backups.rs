//! Scheduled backups of the coordinator, and recovery from the loss of its machine.

use std::path::PathBuf;

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{LONG, SOON, run, wait_for};

use super::{GRID, SHORT_PACE};

/// Finished backups of a folder, the oldest first.
pub(super) fn backups(farm: &Farm, folder: &str) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(farm.path(folder)) else { return vec![] };
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "db"));
    files.sort();
    files
}

/// A farm that lost its disk continues from its last backup.
#[test]
fn farm_resumes_from_its_last_backup() {
    let mut farm = Farm::start(&["--backup-every", "1s", "--keep", "2"]);
    farm.submit("grid", GRID);
    let worker = farm.worker("worker", &[]);
    let digest = farm.done("grid");
    let first = wait_for("a backup of all of it", LONG, || backups(&farm, "data/backups").pop());
    wait_for("the oldest goes", LONG, || (!first.exists()).then_some(()));
    assert!(backups(&farm, "data/backups").len() <= 3, "two, and one in progress");
    assert!(farm.figure("farm_backup_age_seconds") < 30);
    let made = farm.events("BACKUP_MADE");
    assert!(made.iter().any(|e| e["message"].as_str().unwrap().contains("36 records")), "{made:?}");

    // Killed at an arbitrary moment, even during a backup; only the backups on the disk survive.
    farm.kill_coordinator();
    std::fs::rename(farm.path("data/backups"), farm.path("kept")).unwrap();
    std::fs::remove_dir_all(farm.path("data")).unwrap();
    let newest = backups(&farm, "kept").pop().unwrap();
    let restored = run(farm.folder(), &["restore", newest.to_str().unwrap(), "--data", "data"]);
    assert_eq!(restored.code, 0, "{}", restored.stderr);
    farm.start_coordinator();
    assert_eq!(farm.done("grid"), digest);
    farm.submit("more", &format!("{GRID}seed = 2\n"));
    farm.done("more");
    drop(worker);
}

/// The standby has the same access file, port and name, as in the deployment guide. Records from after the backup are
/// computed again.
#[test]
fn standby_takes_over_from_the_last_backup() {
    let mut farm = Farm::closed(&[], &["--lease", "2"]);
    farm.submit("grid", GRID);
    let worker = farm.worker("worker", &SHORT_PACE);
    let done = |farm: &Farm| farm.show("grid")["records_done"].as_u64().unwrap();
    wait_for("some records", LONG, || (done(&farm) > 0).then_some(()));
    let kept = farm.ask(&["backup", "last.db"])["records"].as_u64().unwrap();
    let before = wait_for("more records, which will be lost", LONG, || {
        let now = done(&farm);
        (now > kept).then_some(now)
    });
    assert_eq!(farm.show("grid")["state"], "running", "it is incomplete");
    farm.kill_coordinator();
    std::fs::remove_dir_all(farm.path("data")).unwrap();

    let restored = run(farm.folder(), &["restore", "last.db", "--data", "standby"]);
    assert_eq!(restored.code, 0, "{}", restored.stderr);
    farm.stand_in("standby");
    assert!(kept < before, "{kept} records of {before} were in the backup");
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    let show = farm.show("grid");
    assert_eq!((show["records_done"].as_u64(), show["jobs_failed"].as_u64()), (Some(36), Some(0)));
    assert!(farm.events("WORKER_FENCED").is_empty() && farm.events("ATTEMPT_FAILED").is_empty());
    drop(worker);
}

/// A backup that fails is reported and delays no work.
#[test]
fn failed_backup_is_reported_without_delay() {
    let place = tempfile::tempdir().unwrap();
    // Not even root can create a folder there.
    let nowhere = place.path().join("file");
    std::fs::write(&nowhere, "").unwrap();
    let farm = Farm::start(&["--backup-every", "1s", "--backups", nowhere.join("in").to_str().unwrap()]);
    wait_for("the failure's event", SOON, || {
        let failed = farm.events("BACKUP_FAILED");
        failed.first()?["message"].as_str()?.contains("cannot be used for backups").then_some(())
    });
    farm.submit("grid", GRID);
    let _worker = farm.worker("worker", &[]);
    farm.done("grid");
    assert!(!farm.page("/metrics").unwrap().1.contains("farm_backup_age_seconds"));
}
