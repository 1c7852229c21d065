//! Settings of the coordinator.

use std::path::PathBuf;
use std::time::Duration;

use farm_link::memory::usable_bytes;
use optics_model::limits::FitLimits;

use crate::recompute::{Recompute, recompute};

#[derive(Debug, Clone)]
pub struct Config {
    /// Folder of the database and of the lock that keeps a second coordinator out.
    pub data_dir: PathBuf,
    /// Longest silence of a worker before its leases go to others.
    pub lease: Duration,
    /// Attempts after which a job is given up.
    pub max_attempts: u32,
    /// Share of the results that the coordinator computes too, for comparison; 0 to 1.
    pub check_share: f64,
    /// How the coordinator computes a job.
    pub recompute: Recompute,
    /// Connections beyond this many are refused.
    pub max_connections: usize,
    /// Memory for the dictionaries that are fitted with, in bytes.
    pub fit_memory_bytes: usize,
    /// Most pixels of one question about measurements.
    pub question_pixels: usize,
    /// Whether the start of the coordinator is recorded as an event.
    pub start_is_event: bool,
    /// Whether dictionaries that are unfinished at the start wait until they are resumed, without a change in the
    /// database: a command computes its own.
    pub holds_unfinished: bool,
}

impl Config {
    /// Most memory for the dictionaries that are fitted with, in bytes, if none is given.
    const FIT_MEMORY_BYTES: u64 = 4 << 30;

    /// Memory for the dictionaries that are fitted with if none is given: half of what this process may use, which leaves
    /// room for those that are being read and for answers.
    fn fit_memory_bytes(usable: Option<u64>) -> usize {
        usable.map_or(Self::FIT_MEMORY_BYTES, |usable| (usable / 2).min(Self::FIT_MEMORY_BYTES)) as usize
    }

    pub fn new(data_dir: impl Into<PathBuf>) -> Self {
        Self {
            data_dir: data_dir.into(),
            lease: Duration::from_secs(30),
            max_attempts: 3,
            check_share: 0.01,
            recompute,
            max_connections: 4096,
            fit_memory_bytes: Self::fit_memory_bytes(usable_bytes()),
            question_pixels: FitLimits::QUESTION_PIXELS,
            start_is_event: true,
            holds_unfinished: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fits take at most half of the available memory, and at most 4 GiB.
    #[test]
    fn fits_take_half_of_available_memory() {
        assert_eq!(Config::fit_memory_bytes(None), 4 << 30);
        assert_eq!(Config::fit_memory_bytes(Some(64 << 30)), 4 << 30);
        assert_eq!(Config::fit_memory_bytes(Some(1 << 30)), 512 << 20);
    }
}
