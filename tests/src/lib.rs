//! Shared by the tests of the whole system: a farm of real processes, the built programs, reference data with their
//! origin, and statistics.

#![expect(clippy::missing_errors_doc, clippy::unwrap_used, reason = "helpers of tests")]

pub mod cli;
pub mod cluster;
pub mod coverage;
pub mod dng;
pub mod farm;
pub mod grids;
pub mod memory_group;
pub mod page;
pub mod photograph;
pub mod process;
pub mod proxy;
pub mod reference;
pub mod statistics;
pub mod stored;
pub mod test_worker;
pub mod usage;
pub mod wall_clock;
