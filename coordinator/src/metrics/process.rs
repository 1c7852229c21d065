//! Reads the use of memory, files and processor time by this process, for the standard metrics of Prometheus clients.

/// Resource use of this process. Values that the system does not provide are left out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Process {
    pub(super) resident_memory_bytes: Option<u64>,
    pub(super) open_fds: Option<u64>,
    pub(super) cpu_seconds: f64,
}

impl Process {
    pub(super) fn now() -> Self {
        Self {
            resident_memory_bytes: resident_memory_bytes(),
            open_fds: open_fds(),
            cpu_seconds: cpu_seconds(),
        }
    }
}

/// Reads `/proc`, which exists on Linux alone.
fn resident_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim_end().parse().ok()?;
    Some(kib * 1024)
}

/// The descriptor with which the folder is read is not counted.
fn open_fds() -> Option<u64> {
    let entries = std::fs::read_dir("/proc/self/fd").ok()?;
    Some((entries.count() as u64).saturating_sub(1))
}

fn cpu_seconds() -> f64 {
    let used = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    used.tv_sec as f64 + used.tv_nsec as f64 * 1e-9
}
