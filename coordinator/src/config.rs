//! Settings of the coordinator.

use std::path::PathBuf;
use std::time::Duration;

#[derive(Debug, Clone)]
pub struct Config {
    /// Folder of the database and of the lock that keeps a second coordinator out.
    pub data_dir: PathBuf,
    /// How long a worker may be silent before its leases go to others.
    pub lease: Duration,
    /// Attempts after which a job is given up.
    pub max_attempts: u32,
}

impl Config {
    pub fn new(data_dir: impl Into<PathBuf>) -> Self {
        Self { data_dir: data_dir.into(), lease: Duration::from_secs(30), max_attempts: 3 }
    }
}
