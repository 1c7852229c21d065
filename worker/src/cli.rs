//! The command line of `farm-worker`.

use std::path::PathBuf;
use std::time::Duration;

use clap::Parser;
use farm_link::logs::LogFormat;
use farm_link::walltime::{parse_span, parse_time_limit};

/// Leases jobs from a coordinator and traces them on all cores.
///
/// Exits with code 0 when it is asked to stop (SIGTERM, `farmctl workers drain`), when its time limit is near, or when
/// it has been idle for long enough; with 4 if the coordinator refuses it for good; with 1 on any other error.
#[derive(Debug, Parser)]
#[command(name = "farm-worker", version, after_help = EXAMPLES)]
pub struct Args {
    /// URL of the coordinator [default: the access file's, or http://127.0.0.1:7700].
    #[arg(long, value_name = "URL", env = "FARM_SERVER")]
    pub server: Option<String>,
    /// Access file: the coordinator's URL and certificate, and this worker's token.
    #[arg(long, value_name = "FILE", env = "FARM_ACCESS")]
    pub access: Option<PathBuf>,
    /// Threads to trace with [default: all cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
    /// Instructions to trace with: avx512, avx2, sse4.2, sse2, neon or scalar [default: the fastest]. All give the same
    /// bits.
    #[arg(long, value_name = "NAME", env = "FARM_KERNEL")]
    pub kernel: Option<String>,
    /// Name shown to people [default: machine and process].
    #[arg(long, value_name = "TEXT")]
    pub label: Option<String>,
    /// Stop before this much time has passed, such as 90s, 2h or 1-12:00:00.
    #[arg(long, value_name = "DURATION", env = "FARM_TIME_LIMIT", value_parser = parse_time_limit)]
    pub time_limit: Option<Duration>,
    /// How long jobs that are being traced may continue once the worker has to stop.
    #[arg(long, value_name = "DURATION", env = "FARM_GRACE", default_value = "10s", value_parser = parse_span)]
    pub grace: Duration,
    /// Stop after having had no work for this long.
    #[arg(long, value_name = "DURATION", value_parser = parse_time_limit)]
    pub idle_exit: Option<Duration>,
    /// Memory in MiB for results that wait for a coordinator that is away; when it is full, tracing pauses.
    #[arg(long, value_name = "MIB", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub buffer: u32,
    /// Time to wait before each job is traced, for tests of a farm: jobs last without computing.
    #[arg(long, value_name = "MS", env = "FARM_PACE_MS", default_value_t = 0, hide = true)]
    pub pace_ms: u64,
    /// Log format: text, or one JSON object per line. FARM_LOG sets how much is logged, as in FARM_LOG=debug.
    #[arg(long, value_name = "FORMAT", env = "FARM_LOG_FORMAT", default_value = "text")]
    pub log_format: LogFormat,
}

const EXAMPLES: &str = "\
Examples:
  farm-worker                                     work for a coordinator on this machine
  farm-worker --access worker.toml --threads 16 --time-limit 2h";
