//! Settings of a worker.

/// Where to get jobs from and how much to compute at a time.
#[derive(Debug, Clone)]
pub struct Config {
    /// URL of the coordinator, as in `http://127.0.0.1:7700`.
    pub coordinator: String,
    /// Threads that trace.
    pub threads: usize,
    /// Tells people which worker this is.
    pub label: String,
}

impl Config {
    /// A worker on all cores, named after its process.
    pub fn new(coordinator: impl Into<String>) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, Into::into);
        Self { coordinator: coordinator.into(), threads, label: format!("process {}", std::process::id()) }
    }
}
