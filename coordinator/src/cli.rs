//! The command line of `farm-coordinator`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Parser;
use farm_link::arguments::listen_address;
use farm_link::logs::LogFormat;

/// Splits parameter grids into jobs for workers, stores the records and answers fits.
#[derive(Debug, Parser)]
#[command(name = "farm-coordinator", version, after_help = EXAMPLES)]
pub struct Args {
    /// Address to listen on. One that other machines can reach needs --access or --insecure.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7700", env = "FARM_LISTEN", value_parser = listen_address)]
    pub listen: SocketAddr,
    /// Address for metrics and health checks over HTTP: /metrics, /livez, /readyz [default: none].
    #[arg(long, value_name = "ADDR", env = "FARM_METRICS", value_parser = listen_address)]
    pub metrics: Option<SocketAddr>,
    /// Folder for the database; it must not be on a network filesystem.
    #[arg(long, value_name = "DIR", default_value = "farm-data", env = "FARM_DATA")]
    pub data: PathBuf,
    /// Seconds of silence after which a worker's leases go to other workers.
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub lease: u64,
    /// Failed attempts after which a job is given up.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub max_attempts: u32,
    /// Share of the results, 0 to 1, that the coordinator computes again on one thread for comparison.
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = share)]
    pub verify_share: f64,
    /// Largest number of connections; further ones are refused.
    #[arg(long, value_name = "N", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub max_connections: u32,
    /// Memory for dictionaries that fits use, in MiB; the least recently used are evicted [default: 4096, or half of the
    /// memory that this process may use if that is less].
    #[arg(long, value_name = "MIB", env = "FARM_FIT_MEMORY")]
    pub fit_memory: Option<usize>,
    /// The coordinator's access file, with its certificate and tokens; created by `farmctl access create`.
    #[arg(long, value_name = "FILE", env = "FARM_ACCESS")]
    pub access: Option<PathBuf>,
    /// Log format: text, or one JSON object per line. FARM_LOG sets how much is logged, as in FARM_LOG=debug.
    #[arg(long, value_name = "FORMAT", env = "FARM_LOG_FORMAT", default_value = "text")]
    pub log_format: LogFormat,
    /// Give full access to every client that reaches the address, without encryption or tokens; only for trusted networks
    /// and machines.
    #[arg(long)]
    pub insecure: bool,
}

const EXAMPLES: &str = "\
Without --access it serves the user who starts it, on this machine: that user's farmctl and farm-worker have access by
themselves, and only those.

Examples:
  farm-coordinator                                serve ./farm-data to this machine, at http://127.0.0.1:7700
  farm-coordinator --listen 0.0.0.0:7700 --access access/coordinator.toml --data /var/lib/farm";

fn share(text: &str) -> Result<f64, String> {
    let share = text.parse::<f64>().ok().filter(|s| (0.0..=1.0).contains(s));
    share.ok_or_else(|| "a number from 0 to 1 is needed".to_owned())
}
