//! Jumps of the machines' clocks, as when they are corrected.

use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::process::{SOON, wait_for};
use farm_tests::wall_clock::WallClock;

use super::{GRID, SHORT_PACE};

/// Work that lasts much longer than the jumps.
const SLOW: &str = "\
sigma_t_per_mm = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20]
albedo = [0.5, 0.9]
g = [0.0, 0.4]
thickness_mm = [0.5]
walks = 5000
";

/// After any jump, no lease ends early or late, no worker counts as lost, and nothing is computed twice.
#[test]
fn clock_jump_changes_no_result() {
    let Some(clock) = WallClock::find() else {
        eprintln!("SKIPPED: libfaketime is not installed");
        return;
    };
    let farm = Farm::by_wall_clock(clock, &[]);
    let worker = farm.worker("worker", &SHORT_PACE);
    let now_ms = last_event_ms(&farm);
    farm.submit("slow", SLOW);
    for days in [400, -400, 0, -400] {
        farm.leased("slow", 1);
        farm.set_clock_off_by_days(days);
        // Longer than the intervals of lease checks and heartbeats.
        std::thread::sleep(Duration::from_secs(2));
    }
    wait_for("the coordinator's clock has jumped", SOON, || {
        let backup = farm.path("backup.db");
        farm.ask(&["backup", backup.to_str().unwrap()]);
        for kind in ["db", "db.b3"] {
            std::fs::remove_file(backup.with_extension(kind)).unwrap();
        }
        (last_event_ms(&farm) < now_ms - 300 * DAY_MS).then_some(())
    });
    farm.done("slow");
    let jobs = farm.show("slow")["jobs_total"].as_u64().unwrap();
    assert_eq!(farm.figure(r#"farm_jobs_completed_total{outcome="stored"}"#), jobs);
    assert_eq!(farm.figure(r#"farm_jobs_completed_total{outcome="duplicate"}"#), 0);
    assert_eq!(farm.figure("farm_leases_expired_total"), 0);
    assert_eq!(farm.events("WORKER_LOST"), Vec::<serde_json::Value>::new());

    // Elapsed time, not the difference of two dates.
    assert!(farm.figure("farm_backup_age_seconds") < 3600);

    // Events stay in the order in which they happened, even if their times do not.
    farm.submit("later", &format!("{GRID}seed = 2\n"));
    farm.done("later");
    let submitted = farm.events("SUBMITTED");
    let names: Vec<_> = submitted.iter().map(|event| event["dictionary"].as_str().unwrap()).collect();
    assert_eq!(names, ["slow", "later"]);
    drop(worker);
}

const DAY_MS: i64 = 24 * 3600 * 1000;

/// Time of the last event by the coordinator's clock.
fn last_event_ms(farm: &Farm) -> i64 {
    farm.ask(&["events", "-n", "1"])["events"][0]["unix_ms"].as_i64().unwrap()
}
