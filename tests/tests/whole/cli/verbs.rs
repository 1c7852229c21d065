//! All verbs of the real programs, over TLS with access files: exit codes, backup, restore.

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{LONG, Ran, SOON, run, wait_for};
use farm_tests::test_worker::TestWorker;
use serde_json::Value;

const GRID: &str = "sigma_t_per_mm = [4, 8]\nalbedo = [0.9, 0.999]\ng = [0.0, 0.4]\nwalks = 50000\n";

struct Site {
    farm: Farm,
}

impl Site {
    /// Runs `farmctl` with the file of a role.
    fn run(&self, role: &str, args: &[&str]) -> Ran {
        self.farm.farmctl_with(&format!("keys/{role}.toml"), args)
    }

    /// Runs `farmctl --json` with the file of a role; checks the exit code.
    fn ends(&self, code: i32, role: &str, args: &[&str]) -> Value {
        let ran = self.run(role, &[args, &["--json"]].concat());
        assert_eq!(ran.code, code, "{args:?}: {} {}", ran.stdout, ran.stderr);
        serde_json::from_str(&ran.stdout).unwrap()
    }

    fn client(&self, args: &[&str]) -> Value {
        self.ends(0, "client", args)["data"].take()
    }

    fn digest(&self, name: &str) -> String {
        self.client(&["show", name])["records_digest"].as_str().unwrap().to_owned()
    }

    /// Registers a worker that reports `most` jobs as failed.
    async fn give_up(&self, most: u32) {
        let link = self.farm.link_with("keys/worker.toml");
        let mut weak = TestWorker::register(link, "weak").await.unwrap();
        for lease in weak.acquire(most).await.unwrap() {
            weak.fail(&lease, "out of memory").await.unwrap();
        }
        weak.leave().await.unwrap();
    }
}

fn explains(site: &Site, name: &str, code: &str) {
    let reasons = site.client(&["explain", name])["reasons"].take();
    assert!(reasons.as_array().unwrap().iter().any(|r| r["code"] == code), "{code}: {reasons}");
}

/// A restored backup has the same digest.
#[tokio::test(flavor = "multi_thread")]
async fn all_verbs_work_over_tls() {
    let farm = Farm::closed(&[], &["--max-attempts", "1", "--lease", "5"]);
    let mut site = Site { farm };
    std::fs::write(site.farm.path("grid.toml"), GRID).unwrap();
    std::fs::write(site.farm.path("other.toml"), format!("{GRID}seed = 2\n")).unwrap();
    assert_eq!(site.run("admin", &["health"]).code, 0);
    // There are no workers.
    site.client(&["submit", "grid.toml"]);
    explains(&site, "grid", "NO_WORKERS");
    site.ends(6, "client", &["wait", "grid", "--timeout", "1"]);
    // Pause, resume, cancel, priority.
    assert_eq!(site.client(&["pause", "grid"])["state"], "paused");
    explains(&site, "grid", "PAUSED");
    let worker = site.farm.worker("worker", &[]);
    wait_for("the worker is in", SOON, || {
        (site.client(&["workers"])["workers"].as_array()?.len() == 1).then_some(())
    });
    site.client(&["submit", "other.toml", "--priority", "-5"]);
    assert_eq!(site.client(&["priority", "other", "7"])["priority"], 7);
    site.ends(0, "client", &["wait", "other", "--timeout", "120"]);
    assert_eq!(site.client(&["show", "grid"])["jobs_done"], 0, "a paused dictionary is not computed");
    assert_eq!(site.client(&["cancel", "grid", "--reason", "not now"])["state"], "cancelled");
    site.ends(5, "client", &["wait", "grid"]);
    explains(&site, "grid", "CANCELLED");
    drop(worker);
    // Jobs that cannot be computed.
    site.client(&["resume", "grid"]);
    site.give_up(2).await;
    let worker = site.farm.worker("worker", &[]);
    site.ends(3, "client", &["wait", "grid", "--timeout", "120"]);
    explains(&site, "grid", "JOBS_GIVEN_UP");
    assert!(site.client(&["show", "grid"]).to_string().contains("out of memory"));
    site.client(&["retry", "grid"]);
    site.ends(0, "client", &["wait", "grid", "--timeout", "120"]);
    let digest = site.digest("grid");
    assert_eq!(digest, undisturbed(GRID));
    // Backup and restore.
    let backup = site.ends(0, "admin", &["backup", "copy.db"])["data"].take();
    assert_eq!(backup["records"], 32);
    assert_eq!(site.run("client", &["backup", "mine.db"]).code, 1, "clients may not make backups");
    let kinds: Vec<_> = site.client(&["events"])["events"].as_array().unwrap().clone();
    for kind in
        ["SUBMITTED", "PAUSED", "PRIORITY_CHANGED", "CANCELLED", "RESUMED", "JOB_FAILED", "RETRIED", "DONE"]
    {
        assert!(kinds.iter().any(|e| e["kind"] == kind), "event {kind}");
    }
    let restored = run(site.farm.folder(), &["restore", "copy.db", "--data", "restored"]);
    assert_eq!(restored.code, 0, "{}", restored.stderr);
    // Deleting.
    assert_eq!(site.run("client", &["delete", "other"]).code, 1, "nothing is deleted without --yes");
    assert_eq!(site.client(&["delete", "other", "--yes"])["records_deleted"], 16);
    assert_eq!(site.run("client", &["show", "other"]).code, 1);
    site.farm.move_to("restored");
    assert_eq!((site.digest("grid"), site.digest("other").len()), (digest, 64));
    wait_for("the worker comes back", LONG, || {
        (site.client(&["workers"])["workers"].as_array()?.len() == 1).then_some(())
    });
    let doctor = site.run("admin", &["doctor"]);
    assert_eq!(doctor.code, 0, "{}", doctor.stdout);
    drop(worker);
}
