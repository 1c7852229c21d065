//! Recovery from the loss of the coordinator's machine.

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{LONG, run, wait_for};

use super::{GRID, SHORT_PACE};

/// The standby has the same access file, port and name, as in the deployment guide. Records from after the backup are
/// computed again.
#[test]
fn standby_takes_over_from_the_last_backup() {
    let mut farm = Farm::closed(&[], &["--lease", "2"]);
    farm.submit("grid", GRID);
    let worker = farm.worker("worker", &SHORT_PACE);
    let done = |farm: &Farm| farm.show("grid")["records_done"].as_u64().unwrap();
    wait_for("some records", LONG, || (done(&farm) > 0).then_some(()));
    assert!(!farm.page("/metrics").unwrap().1.contains("farm_backup_age_seconds"));
    let kept = farm.ask(&["backup", "last.db"])["records"].as_u64().unwrap();
    assert!(farm.figure("farm_backup_age_seconds") < 30);
    let made = farm.events("BACKUP_MADE");
    assert!(made[0]["message"].as_str().unwrap().starts_with(&format!("{kept} records")), "{made:?}");
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
