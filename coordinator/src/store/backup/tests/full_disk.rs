use std::io::Write;
use std::process::Command;

use super::*;

/// A small filesystem in memory, for as long as this lives.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    fn mount() -> Option<Self> {
        let dir = tempfile::tempdir().unwrap();
        let mount =
            Command::new("mount").args(["-t", "tmpfs", "-o", "size=512k", "tmpfs"]).arg(dir.path()).output();
        mount.is_ok_and(|done| done.status.success()).then_some(Self(dir))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

/// On a full disk a backup fails with that reason and leaves no files.
#[tokio::test]
async fn full_disk_fails_the_backup_cleanly() {
    let Some(disk) = SmallDisk::mount() else {
        // Written past the capture of output, so that this is not taken for a test that was run.
        let _ = writeln!(std::io::stderr(), "SKIPPED: a full disk was not tested; mounting one needs root");
        return;
    };
    let (dir, copy) = with_backup().await;
    let pool = reader(&dir.path().join("farm.db")).await;
    let error = backup(&pool, &disk.0.path().join("copy"), newest()).await.unwrap_err().to_string();
    assert!(error.contains("copying the database") && error.contains("full"), "{error}");
    assert_eq!(std::fs::read_dir(disk.0.path()).unwrap().count(), 0);
    let home = DataDir::lock(disk.0.path()).unwrap();
    let error = restore(&copy, &home, newest()).await.unwrap_err().to_string();
    assert!(error.contains("No space left on device"), "{error}");
    let left: Vec<_> =
        std::fs::read_dir(disk.0.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["lock"]);
    pool.close().await;
}
