//! Faults of a farm of real processes: each test is named after the guarantee that it checks.
//!
//! Short by default; `FARM_TEST_EFFORT=20` runs more rounds with longer pauses, up to those of real links and
//! keepalives.

mod away;
mod backups;
mod clock;
mod crowd;
mod damage;
mod disk;
mod export;
mod interrupted;
mod kill;
mod leave;
mod limits;
mod links;
mod logs;
mod loopback;
mod lost;
mod malicious;
mod owners;
mod poison;
mod refused;
mod slow;
mod trust;
mod waiting;

use std::time::Duration;

use farm_tests::statistics::effort;

/// 12 jobs of 36 records.
const GRID: &str = "\
sigma_t_per_mm = [2, 8]
albedo = [0.5, 0.9, 0.99]
g = [0.0, 0.4, 0.8]
walks = 5000
";
const JOBS: u64 = 12;
const RECORDS: u64 = 36;

/// Two jobs, for workers with [`LONG_PACE`].
const LONG_JOBS: &str = "\
sigma_t_per_mm = [8, 9]
albedo = [0.9, 0.999]
g = [0.4]
thickness_mm = [1.0]
walks = 5000
";

/// Worker's options: each job lasts some tenths of a second without computing.
const SHORT_PACE: [&str; 2] = ["--pace-ms", "250"];
/// … or some seconds.
const LONG_PACE: [&str; 2] = ["--pace-ms", "4000"];

/// A short pause in the short form, a long one in the long form.
fn short_or_long(short: Duration, long: Duration) -> Duration {
    if effort() > 1 { long } else { short }
}
