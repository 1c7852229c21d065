//! Settings of a worker.

use std::time::Duration;

use farm_link::Target;

use crate::machine;

/// The source of a worker's jobs, the amount to compute at a time, and the conditions under which it stops.
#[derive(Debug, Clone)]
pub struct Config {
    /// The coordinator, and how to connect to it.
    pub coordinator: Target,
    /// Threads that trace.
    pub threads: usize,
    /// Name of this worker, shown to users.
    pub label: String,
    /// Identifies this machine, whichever process runs on it.
    pub host: String,
    /// The place at which this worker's log can be read; empty if unknown.
    pub log: String,
    /// Memory for undelivered results: when it is full, tracing waits.
    pub buffer_bytes: usize,
    /// Time for which running jobs may continue once the worker stops.
    pub grace: Duration,
    /// Limit of the run time. The worker stops early enough to hand everything back before it.
    pub time_limit: Option<Duration>,
    /// Stop after this long without work.
    pub idle_exit: Option<Duration>,
    /// Kernel to trace with; the fastest if None.
    pub kernel: Option<String>,
    /// Time that a thread waits before it traces a job, so that jobs last without computing; for tests.
    pub pace: Duration,
}

impl Config {
    /// A worker on all cores, named after its machine and process, without a grace period.
    pub fn new(coordinator: Target) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, Into::into);
        Self {
            coordinator,
            threads,
            label: format!("{}:{}", machine::name(), std::process::id()),
            host: machine::id(),
            log: String::new(),
            buffer_bytes: 256 << 20,
            grace: Duration::ZERO,
            time_limit: None,
            idle_exit: None,
            kernel: None,
            pace: Duration::ZERO,
        }
    }
}
