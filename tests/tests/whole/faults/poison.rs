//! A job that kills its worker.

use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::process::wait_for;

use super::{LONG_JOBS, LONG_PACE};

/// The job is blamed even before the first heartbeat, and the others are completed. The explanation names the worker's log.
#[test]
fn job_that_kills_its_worker_is_blamed() {
    // Heartbeats come every five seconds.
    let farm = Farm::start(&["--lease", "20", "--max-attempts", "1"]);
    farm.submit("long", LONG_JOBS);
    let mut victim = farm.worker("victim", &LONG_PACE);
    victim.wait_for_log("job begins");
    victim.kill();
    let quarantined =
        wait_for("its death is noticed", Duration::from_mins(1), || farm.events("JOB_QUARANTINED").pop());
    assert!(quarantined["message"].as_str().unwrap().contains("victim fell silent"), "{quarantined}");
    assert_eq!(farm.events("ATTEMPT_FAILED").len(), 1, "the job that waited for a thread is not blamed");
    // The explanation names the log with the worker's messages.
    let explained = farm.farmctl(&["explain", "long"]).stdout;
    let (_, place) = explained.split_once(" (log: ").expect(&explained);
    let (_, file) = place.split_once(')').unwrap().0.split_once(':').unwrap();
    assert!(std::fs::read_to_string(file).unwrap().contains("joined the coordinator"), "{file}");
    let worker = farm.worker("worker", &[]);
    let waited = farm.farmctl(&["wait", "long", "--timeout", "120"]);
    assert_eq!(waited.code, 4, "{} {}", waited.stdout, waited.stderr);
    let show = farm.show("long");
    assert_eq!((show["state"].as_str(), show["jobs_done"].as_u64()), (Some("failed"), Some(1)));
    drop(worker);
}
