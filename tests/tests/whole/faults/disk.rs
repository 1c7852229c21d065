//! A full disk.

use std::path::PathBuf;
use std::process::Command;

use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{LONG, SOON, run as run_farmctl, wait_for};
use serde_json::Value;

/// 240 records of 26 kB, which do not fit.
const GRID: &str = "\
sigma_t_per_mm = [2, 4, 8, 10]
albedo = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.99]
g = [0.0, 0.4, 0.8]
walks = 10000
derivatives = true
";
const JOBS: u64 = 24;
const RECORDS: u64 = 240;

/// A filesystem in memory. Unmounted when dropped.
struct Small(PathBuf);

impl Small {
    /// None without the right to mount.
    fn mount(folder: PathBuf, size: &str) -> Option<Self> {
        std::fs::create_dir(&folder).unwrap();
        let path = folder.to_str().unwrap();
        let size = format!("size={size}");
        let mounted = run(Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs", path]));
        mounted.then_some(Self(folder))
    }

    fn enlarge(&self, size: &str) {
        let option = format!("remount,size={size}");
        assert!(run(Command::new("mount").args(["-o", &option]).arg(&self.0)));
    }
}

impl Drop for Small {
    fn drop(&mut self) {
        run(Command::new("umount").arg("--lazy").arg(&self.0));
    }
}

fn run(command: &mut Command) -> bool {
    command.output().is_ok_and(|output| output.status.success())
}

fn acknowledged(farm: &Farm) -> u64 {
    farm.worker_logs().iter().filter(|line| line.to_string().contains("job done")).count() as u64
}

fn done(farm: &Farm) -> u64 {
    farm.show("grid")["jobs_done"].as_u64().unwrap()
}

/// Readiness, status and explain report the reason.
#[tokio::test(flavor = "multi_thread")]
async fn full_disk_acknowledges_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let Some(disk) = Small::mount(data.clone(), "6m") else {
        eprintln!("SKIPPED: only root may mount the small disk that this test needs");
        return;
    };
    let mut farm = Farm::with_data(folder, data, &["--verify-share", "0", "--lease", "2"]);
    farm.submit("grid", GRID);
    let mut worker = farm.worker("worker", &[]);
    let (_, reason) =
        wait_for("the disk is full", LONG, || farm.page("/readyz").filter(|(code, _)| *code == 503));
    assert!(reason.contains("results cannot be stored") && reason.contains("full"), "{reason}");
    let status = farm.ask(&["status"]);
    assert!(status["store_fault"].as_str().is_some_and(|fault| fault.contains("full")), "{status}");
    let status = farm.farmctl(&["status"]).stdout;
    assert!(status.contains("results cannot be stored"), "{status}");
    let explained: Value = farm.ask(&["explain", "grid"]);
    assert_eq!(explained["reasons"][0]["code"], "STORE_FAULT", "{explained}");
    let before = done(&farm);
    assert!(before < JOBS, "the disk was too large for this test");
    assert!(acknowledged(&farm) <= before, "acknowledged and not stored");
    assert!(worker.is_running());
    disk.enlarge("256m");
    let digest = farm.done("grid");
    assert_eq!(digest, undisturbed(GRID));
    wait_for("it is ready again", SOON, || farm.page("/readyz").filter(|(code, _)| *code == 200));
    assert_eq!(acknowledged(&farm), JOBS, "the worker kept results that were not stored");
    assert!(farm.events("ATTEMPT_FAILED").is_empty());
    // Finished records are on the disk, not only in memory.
    farm.kill_coordinator();
    farm.start_coordinator();
    assert_eq!(farm.done("grid"), digest);
    assert_eq!(farm.stop_coordinator(), 0);
    assert_eq!(farm.record_rows().await, (RECORDS, 0));
    drop((worker, farm));
    drop(disk);
}

/// Without a server the command ends with what to do, and continues once there is room.
#[test]
fn full_disk_ends_a_local_submission() {
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = Small::mount(folder.path().join("small"), "6m") else {
        eprintln!("SKIPPED: only root may mount the small disk that this test needs");
        return;
    };
    std::fs::write(folder.path().join("grid.toml"), GRID).unwrap();
    let submit = ["submit", "grid.toml", "--data", "small/data", "--json"];
    let full = run_farmctl(folder.path(), &submit);
    assert_eq!(full.code, 1, "{}", full.stdout);
    for part in ["results cannot be stored", "of 240 records are there", "make room on the disk"] {
        assert!(full.stdout.contains(part), "{}", full.stdout);
    }
    disk.enlarge("256m");
    let done = run_farmctl(folder.path(), &submit);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(done.stdout.contains(&undisturbed(GRID)), "{}", done.stdout);
    drop(disk);
}

/// Clients leave room on the disk: dictionaries can be deleted, and results stored, when no more is taken.
#[tokio::test(flavor = "multi_thread")]
async fn clients_leave_room_on_the_disk() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let Some(disk) = Small::mount(data.clone(), "64m") else {
        eprintln!("SKIPPED: only root may mount the small disk that this test needs");
        return;
    };
    let farm = Farm::with_data(folder, data.clone(), &[]);
    farm.submit("grid", crate::faults::GRID);
    // Less than a twentieth of the disk is left.
    std::fs::write(data.join("filler"), vec![7; 61 << 20]).unwrap();
    std::fs::write(farm.path("grid.toml"), format!("{}seed = 2\n", crate::faults::GRID)).unwrap();
    let (grid, copy) = (farm.path("grid.toml"), farm.path("copy.db"));
    for refused in
        [&["submit", grid.to_str().unwrap(), "--name", "more"], &["backup", copy.to_str().unwrap()][..]]
    {
        let ran = farm.farmctl(refused);
        assert_eq!(ran.code, 1, "{refused:?}: {}", ran.stdout);
        assert!(ran.stderr.contains("kept for results and deletions"), "{}", ran.stderr);
    }
    assert_eq!(farm.events("BACKUP_FAILED").len(), 1);
    let worker = farm.worker("worker", &[]);
    assert_eq!(farm.done("grid"), undisturbed(crate::faults::GRID));
    assert_eq!(farm.farmctl(&["delete", "grid", "--yes"]).code, 0);
    drop((worker, farm));
    drop(disk);
}
