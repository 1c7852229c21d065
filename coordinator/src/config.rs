//! Settings of the coordinator.

use std::path::PathBuf;
use std::time::Duration;

use crate::farm::BackupSchedule;

#[derive(Debug, Clone)]
pub struct Config {
    /// Folder of the database and of the lock that keeps a second coordinator out.
    pub data_dir: PathBuf,
    /// How long a worker may be silent before its leases go to others.
    pub lease: Duration,
    /// Attempts after which a job is given up.
    pub max_attempts: u32,
    /// Share of the results that a second worker computes too, for comparison; 0 to 1.
    pub check_share: f64,
    /// Connections beyond this many are refused.
    pub max_connections: usize,
    /// Memory for the dictionaries that are fitted with, in bytes.
    pub fit_memory_bytes: usize,
    /// Backups that it makes by itself.
    pub backups: Option<BackupSchedule>,
}

impl Config {
    /// Memory for the dictionaries that are fitted with if nothing is told, in MiB.
    pub const FIT_MEMORY_MIB: usize = 4096;

    pub fn new(data_dir: impl Into<PathBuf>) -> Self {
        Self {
            data_dir: data_dir.into(),
            lease: Duration::from_secs(30),
            max_attempts: 3,
            check_share: 0.01,
            max_connections: 4096,
            fit_memory_bytes: Self::FIT_MEMORY_MIB << 20,
            backups: None,
        }
    }
}
