//! Creates a control group with a memory limit for processes of the tests, as containers and batch systems use.
//!
//! It needs Linux with version 1 of the memory controller, and root; elsewhere there is no group.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// Mount point of the memory controller.
const MOUNT: &str = "/sys/fs/cgroup/memory";

/// Removed when dropped; its processes must have ended by then.
#[derive(Debug)]
pub struct MemoryGroup {
    folder: PathBuf,
}

impl MemoryGroup {
    /// A group whose processes share `limit_bytes`; None where groups cannot be created.
    pub fn with_limit(limit_bytes: u64) -> Option<Self> {
        let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
        let own = groups.lines().find_map(|line| line.split_once(":memory:").map(|(_, path)| path))?;
        let folder = Path::new(MOUNT).join(own.trim_start_matches('/'));
        let folder = folder.join(format!("farm-tests-{}", std::process::id()));
        std::fs::create_dir(&folder).ok()?;
        let group = Self { folder };
        std::fs::write(group.folder.join("memory.limit_in_bytes"), limit_bytes.to_string()).ok()?;
        Some(group)
    }

    /// A command that joins the group and then executes the program.
    pub fn command(&self, program: &OsStr) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", r#"echo $$ >"$0" && exec "$@""#]);
        command.arg(self.folder.join("cgroup.procs")).arg(program);
        command
    }

    /// Peak memory of its processes, in bytes.
    ///
    /// # Panics
    /// If the system does not report it.
    pub fn peak_bytes(&self) -> u64 {
        let peak = std::fs::read_to_string(self.folder.join("memory.max_usage_in_bytes"));
        peak.ok().and_then(|bytes| bytes.trim().parse().ok()).expect("a number of bytes")
    }
}

impl Drop for MemoryGroup {
    fn drop(&mut self) {
        // A killed process is counted for a moment longer.
        for _ in 0..50 {
            if std::fs::remove_dir(&self.folder).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}
