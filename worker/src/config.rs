//! Settings of a worker.

use std::time::Duration;

use farm_link::Target;

use crate::machine;

/// Where to get jobs from, how much to compute at a time and when to stop.
#[derive(Debug, Clone)]
pub struct Config {
    /// The coordinator, and how to connect to it.
    pub coordinator: Target,
    /// Threads that trace.
    pub threads: usize,
    /// Tells people which worker this is.
    pub label: String,
    /// Tells this machine from others, whichever process runs on it.
    pub host: String,
    /// Where this worker's log is to be read; empty if nobody can.
    pub log: String,
    /// Memory for results that wait to be delivered: when it is full, tracing waits.
    pub buffer_bytes: usize,
    /// How long jobs may go on that are being traced when the worker is told to stop.
    pub grace: Duration,
    /// Stop so long before this time after the start that everything is handed back in time.
    pub time_limit: Option<Duration>,
    /// Stop when there was no work for so long.
    pub idle_exit: Option<Duration>,
    /// Kernel to trace with; the fastest if none is told.
    pub kernel: Option<String>,
}

impl Config {
    /// A worker on all cores, named after its machine and process, that stops at once when it is told to.
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
        }
    }
}
