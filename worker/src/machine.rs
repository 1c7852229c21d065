//! Identifies this machine and its equipment: its name, an id that no other machine has, and its hardware.

use farm_proto::status::MachineFacts;
use optics_tracer::Kernel;

/// The host name.
pub(crate) fn name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name = name.trim();
    if name.is_empty() { "worker".to_owned() } else { name.to_owned() }
}

/// A random number of this boot of the machine, equal in all its containers. Empty if the system provides none.
pub(crate) fn id() -> String {
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    boot.trim().chars().take(64).collect()
}

/// Hardware and software of this machine, shown to administrators.
pub(crate) fn facts(kernel: Kernel, log: String) -> MachineFacts {
    let cores = std::thread::available_parallelism().map_or(0, |cores| cores.get() as u32);
    MachineFacts {
        cores,
        memory_bytes: farm_link::memory::usable_bytes().unwrap_or(0),
        kernel: kernel.name().to_owned(),
        log,
    }
}
