//! A control group with a limit of memory, as containers and batch systems have them, for processes of the tests.
//!
//! Linux with version 1 of the memory controller mounted, and the right to make groups (root); elsewhere there is none.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// Where Linux mounts the controller of memory.
const MOUNT: &str = "/sys/fs/cgroup/memory";

/// Removed when dropped, by when its processes must have ended.
#[derive(Debug)]
pub struct MemoryGroup {
    folder: PathBuf,
}

impl MemoryGroup {
    /// A group whose processes have `limit_bytes` together; None where groups cannot be made.
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

    /// Starts the program within the group: it joins before it becomes the program.
    pub fn command(&self, program: &OsStr) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", r#"echo $$ >"$0" && exec "$@""#]);
        command.arg(self.folder.join("cgroup.procs")).arg(program);
        command
    }

    /// The most that its processes had at a time, in bytes.
    ///
    /// # Panics
    /// If the system does not name it.
    pub fn peak_bytes(&self) -> u64 {
        let peak = std::fs::read_to_string(self.folder.join("memory.max_usage_in_bytes"));
        peak.ok().and_then(|bytes| bytes.trim().parse().ok()).expect("a number of bytes")
    }
}

impl Drop for MemoryGroup {
    fn drop(&mut self) {
        // The system counts a process that was killed for a moment longer.
        for _ in 0..50 {
            if std::fs::remove_dir(&self.folder).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}
