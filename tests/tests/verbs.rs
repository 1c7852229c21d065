//! A farm steered from end to end by the real programs, over TLS with access files: verbs, exit codes, backup, restore.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::path::Path;
use std::time::Duration;

use farm_link::{ClientAccess, Target};
use farm_proto::wire::RegisterRequest;
use farm_proto::wire::leases_client::LeasesClient;
use farm_tests::farm_processes::{LONG, Process, SOON, Signal, free_port, undisturbed, wait_for};
use farm_tests::process::{Ran, farmctl};
use serde_json::Value;

const GRID: &str = "sigma_t_per_mm = [4, 8]\nalbedo = [0.9, 0.999]\ng = [0.0, 0.4]\nwalks = 50000\n";

struct Site {
    folder: tempfile::TempDir,
    port: u16,
    data: &'static str,
    coordinator: Process,
}

impl Site {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port = free_port();
        let made: Ran = farmctl(folder.path())
            .args(["access", "create", "keys", "--host", "localhost", "--port", &port.to_string()])
            .output()
            .unwrap()
            .into();
        assert_eq!(made.code, 0, "{}", made.stderr);
        std::fs::write(folder.path().join("grid.toml"), GRID).unwrap();
        std::fs::write(folder.path().join("other.toml"), format!("{GRID}seed = 2\n")).unwrap();
        let coordinator =
            serve(&folder.path().join("keys/coordinator.toml"), port, &folder.path().join("data"));
        let site = Self { folder, port, data: "data", coordinator };
        site.answers();
        site
    }

    fn answers(&self) {
        wait_for("the coordinator answers", SOON, || {
            (self.run("admin", &["health"]).code == 0).then_some(())
        });
    }

    /// Runs `farmctl` with the file of a role.
    fn run(&self, role: &str, args: &[&str]) -> Ran {
        let access = format!("keys/{role}.toml");
        farmctl(self.folder.path()).args(args).args(["--access", &access]).output().unwrap().into()
    }

    /// The same, which must end with this exit code; as JSON.
    fn ends(&self, code: i32, role: &str, args: &[&str]) -> Value {
        let ran = self.run(role, &[args, &["--json"]].concat());
        assert_eq!(ran.code, code, "{args:?}: {} {}", ran.stdout, ran.stderr);
        serde_json::from_str(&ran.stdout).unwrap()
    }

    fn client(&self, args: &[&str]) -> Value {
        self.ends(0, "client", args)["data"].take()
    }

    fn worker(&self) -> Process {
        let (access, log) =
            (self.folder.path().join("keys/worker.toml"), self.folder.path().join("worker.log"));
        let args = ["--access", access.to_str().unwrap(), "--threads", "1", "--label", "worker"];
        Process::start("farm-worker", &args, &log)
    }

    fn digest(&self, name: &str) -> String {
        self.client(&["show", name])["records_digest"].as_str().unwrap().to_owned()
    }

    /// Stops the coordinator and starts it on another folder.
    fn move_to(&mut self, data: &'static str) {
        self.coordinator.signal(Signal::TERM);
        assert_eq!(self.coordinator.exit_within(Duration::from_secs(10)), 0);
        self.data = data;
        let keys = self.folder.path().join("keys/coordinator.toml");
        self.coordinator = serve(&keys, self.port, &self.folder.path().join(data));
        self.answers();
    }

    /// A worker that reports of `most` jobs that it cannot compute them.
    async fn give_up(&self, most: u32) {
        let access = ClientAccess::read(&self.folder.path().join("keys/worker.toml")).unwrap();
        let link = Target::new(Some(&access), None).unwrap().connect_lazy();
        let mut leases = LeasesClient::new(link);
        let request = RegisterRequest {
            label: "weak".to_owned(),
            threads: 1,
            physics_version: optics_model::PHYSICS_VERSION,
            protocol_version: farm_proto::PROTOCOL_VERSION,
            instance: "weak".to_owned(),
            version: String::new(),
        };
        let worker_id = leases.register(request).await.unwrap().into_inner().worker_id;
        let request =
            farm_proto::wire::AcquireRequest { worker_id: worker_id.clone(), max_leases: most, wait_ms: 0 };
        for lease in leases.acquire(request).await.unwrap().into_inner().leases {
            let reason = "out of memory".to_owned();
            let request =
                farm_proto::wire::FailRequest { worker_id: worker_id.clone(), lease: lease.key, reason };
            leases.fail(request).await.unwrap();
        }
        let request = farm_proto::wire::HandBackRequest { worker_id, leases: vec![], leaving: true };
        leases.hand_back(request).await.unwrap();
    }
}

fn serve(access: &Path, port: u16, data: &Path) -> Process {
    let (listen, log) = (format!("127.0.0.1:{port}"), data.with_extension("log"));
    let (access, data) = (access.to_str().unwrap(), data.to_str().unwrap());
    let args =
        ["--listen", &listen, "--access", access, "--data", data, "--max-attempts", "1", "--lease", "5"];
    Process::start("farm-coordinator", &args, &log)
}

fn explains(site: &Site, name: &str, code: &str) {
    let reasons = site.client(&["explain", name])["reasons"].take();
    assert!(reasons.as_array().unwrap().iter().any(|r| r["code"] == code), "{code}: {reasons}");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_verb_works_over_tls_with_its_exit_code_and_a_restored_backup_has_the_same_digest() {
    let mut site = Site::start();
    // Nobody is there to compute.
    site.client(&["submit", "grid.toml"]);
    explains(&site, "grid", "NO_WORKERS");
    site.ends(6, "client", &["wait", "grid", "--timeout", "1"]);
    // Pause, resume, cancel, priority.
    assert_eq!(site.client(&["pause", "grid"])["state"], "paused");
    explains(&site, "grid", "PAUSED");
    let worker = site.worker();
    wait_for("the worker is in", SOON, || {
        (site.client(&["workers"])["workers"].as_array()?.len() == 1).then_some(())
    });
    site.client(&["submit", "other.toml", "--priority", "-5"]);
    assert_eq!(site.client(&["priority", "other", "7"])["priority"], 7);
    site.ends(0, "client", &["wait", "other", "--timeout", "120"]);
    assert_eq!(site.client(&["show", "grid"])["jobs_done"], 0, "what is paused is not computed");
    assert_eq!(site.client(&["cancel", "grid", "--reason", "not now"])["state"], "cancelled");
    site.ends(5, "client", &["wait", "grid"]);
    explains(&site, "grid", "CANCELLED");
    drop(worker);
    // Jobs that cannot be computed.
    site.client(&["resume", "grid"]);
    site.give_up(2).await;
    let worker = site.worker();
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
    assert_eq!(site.run("client", &["backup", "mine.db"]).code, 1, "clients may not");
    let kinds: Vec<_> = site.client(&["events"])["events"].as_array().unwrap().clone();
    for kind in
        ["SUBMITTED", "PAUSED", "PRIORITY_CHANGED", "CANCELLED", "RESUMED", "JOB_FAILED", "RETRIED", "DONE"]
    {
        assert!(kinds.iter().any(|e| e["kind"] == kind), "{kind} is told");
    }
    let restored: Ran = farmctl(site.folder.path())
        .args(["restore", "copy.db", "--data", "restored"])
        .output()
        .unwrap()
        .into();
    assert_eq!(restored.code, 0, "{}", restored.stderr);
    // Deleting.
    assert_eq!(site.run("client", &["delete", "other"]).code, 1, "nothing is deleted without --yes");
    assert_eq!(site.client(&["delete", "other", "--yes"])["records_deleted"], 16);
    assert_eq!(site.run("client", &["show", "other"]).code, 1);
    site.move_to("restored");
    assert_eq!((site.digest("grid"), site.digest("other").len()), (digest, 64));
    wait_for("the worker comes back", LONG, || {
        (site.client(&["workers"])["workers"].as_array()?.len() == 1).then_some(())
    });
    let doctor = site.run("admin", &["doctor"]);
    assert_eq!(doctor.code, 0, "{}", doctor.stdout);
    drop(worker);
}
