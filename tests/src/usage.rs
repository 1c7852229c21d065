//! Reads the use of processor, memory and files by another process from Linux's /proc.

use std::fs::read_to_string;

/// Clock ticks per second: a constant of Linux's interface.
const TICKS: f64 = 100.0;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usage {
    /// Processor time so far of all threads, in user and kernel mode.
    pub cpu_s: f64,
    pub resident_kib: u64,
    /// Peak so far.
    pub peak_kib: u64,
    pub files: usize,
}

impl Usage {
    /// None if the process has ended or is a zombie.
    pub fn of(pid: u32) -> Option<Self> {
        let stat = read_to_string(format!("/proc/{pid}/stat")).ok()?;
        // The name, in parentheses, may contain spaces.
        let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
        let ticks = |field: usize| fields.get(field)?.parse::<f64>().ok();
        let status = read_to_string(format!("/proc/{pid}/status")).ok()?;
        let kib = |field| {
            let line = status.lines().find_map(|line| line.strip_prefix(field))?;
            line.trim().strip_suffix(" kB")?.parse().ok()
        };
        Some(Self {
            cpu_s: (ticks(11)? + ticks(12)?) / TICKS,
            resident_kib: kib("VmRSS:")?,
            peak_kib: kib("VmHWM:")?,
            files: std::fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// This process has memory and open files, and its CPU time grows.
    #[test]
    fn this_process_has_plausible_usage() {
        let before = Usage::of(std::process::id()).unwrap();
        let busy: u64 = (0..200_000_000_u64).fold(0, |a, b| std::hint::black_box(a ^ b));
        let after = Usage::of(std::process::id()).unwrap();
        assert!(
            after.cpu_s > before.cpu_s && after.resident_kib > 100 && after.files > 2,
            "{after:?} {busy}"
        );
        // Counts of two readings may differ by what threads keep for themselves.
        assert!(after.peak_kib >= after.resident_kib, "{before:?} {after:?}");
        assert_eq!(Usage::of(u32::MAX), None);
    }
}
