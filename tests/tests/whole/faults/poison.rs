//! A job that kills its worker.

use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{SOON, wait_for};

use super::{GRID, JOBS, LONG_JOBS, LONG_PACE};

/// The reasons are listed, and the other jobs are completed.
#[tokio::test(flavor = "multi_thread")]
async fn job_with_dying_workers_is_quarantined() {
    let farm = Farm::start(&["--lease", "1", "--max-attempts", "3"]);
    farm.submit("grid", GRID);
    let mut poison = None;
    for death in 1..=3_usize {
        let mut victim = farm.test_worker(&format!("victim-{death}")).await.unwrap();
        let lease = victim.acquire(1).await.unwrap().remove(0);
        assert_eq!(*poison.get_or_insert(lease.key.job), lease.key.job, "a failed job is leased first");
        assert!(victim.renew(&lease, true).await.unwrap());
        // From here on it is silent.
        wait_for("its death is noticed", SOON, || {
            (farm.events("ATTEMPT_FAILED").len() == death).then_some(())
        });
    }
    // Events are written shortly after what they report, not all at once.
    let quarantined = wait_for("the quarantine is listed", SOON, || {
        Some(farm.events("JOB_QUARANTINED")).filter(|all| !all.is_empty())
    });
    assert_eq!((quarantined.len(), quarantined[0]["job"].as_u64()), (1, poison.map(u64::from)));
    let worker = farm.worker("worker", &[]);
    let waited = farm.farmctl(&["wait", "grid", "--timeout", "120"]);
    assert_eq!(waited.code, 4, "{} {}", waited.stdout, waited.stderr);
    let show = farm.show("grid");
    assert_eq!((show["state"].as_str(), show["jobs_done"].as_u64()), (Some("failed"), Some(JOBS - 1)));
    let message = show.to_string();
    for death in 1..=3 {
        assert!(
            message.contains(&format!("victim-{death} fell silent while it computed this job")),
            "{message}"
        );
    }
    let explained = farm.farmctl(&["explain", "grid"]).stdout;
    assert!(explained.contains("1 jobs were given up") && explained.contains("farmctl retry"), "{explained}");
    farm.ask(&["retry", "grid"]);
    let waited = farm.farmctl(&["wait", "grid", "--timeout", "120"]);
    assert_eq!(waited.code, 0, "{} {}", waited.stdout, waited.stderr);
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    drop(worker);
}

/// Jobs that were not begun are not blamed for the death of their worker.
#[tokio::test(flavor = "multi_thread")]
async fn unstarted_jobs_are_not_blamed() {
    let farm = Farm::start(&["--lease", "1", "--max-attempts", "1"]);
    farm.submit("grid", GRID);
    let mut victim = farm.test_worker("victim").await.unwrap();
    let leases = victim.acquire(3).await.unwrap();
    assert!(victim.renew(&leases[0], false).await.unwrap());
    wait_for("its leases expire", Duration::from_secs(10), || {
        (farm.figure("farm_leases_expired_total") == 3).then_some(())
    });
    let worker = farm.worker("worker", &[]);
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert!(farm.events("ATTEMPT_FAILED").is_empty());
    drop(worker);
}

/// The job is blamed even before the first heartbeat. The explanation names the worker's log.
#[tokio::test(flavor = "multi_thread")]
async fn job_that_kills_its_worker_is_blamed() {
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
}
