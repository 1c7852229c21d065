//! What tells this machine from others, and what it has.

use farm_proto::status::MachineFacts;
use optics_tracer::Kernel;

/// Its name.
pub(crate) fn name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name = name.trim();
    if name.is_empty() { "worker".to_owned() } else { name.to_owned() }
}

/// A number that this machine has had since it was started, in containers too, and that no other machine can know. Empty
/// if the system tells none.
pub(crate) fn id() -> String {
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    boot.trim().chars().take(64).collect()
}

/// What it has, for those who look after the farm.
pub(crate) fn facts(kernel: Kernel, log: String) -> MachineFacts {
    let cores = std::thread::available_parallelism().map_or(0, |cores| cores.get() as u32);
    let table = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    MachineFacts {
        cores,
        memory_bytes: memory_bytes(&table).unwrap_or(0),
        kernel: kernel.name().to_owned(),
        log,
    }
}

/// All memory, by the system's table: `MemTotal:  24689764 kB`.
fn memory_bytes(table: &str) -> Option<u64> {
    let line = table.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_are_those_of_this_machine() {
        assert_eq!(memory_bytes("MemTotal:       24689764 kB\nMemFree: 1 kB\n"), Some(24_689_764 * 1024));
        assert_eq!(memory_bytes("nothing"), None);
        let facts = facts(Kernel::fastest(), String::new());
        assert!(facts.cores >= 1 && !facts.kernel.is_empty(), "{facts:?}");
    }
}
