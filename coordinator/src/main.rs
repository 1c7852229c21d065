//! `farm-coordinator`: parses the command line, opens the port, runs the library until a signal.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use clap::Parser;
use farm_coordinator::store::DataDir;
use farm_coordinator::{BackupSchedule, Config, Coordinator, Gate};
use farm_link::logs::LogFormat;
use farm_link::walltime::parse_time_limit;
use farm_link::{CoordinatorAccess, logs, signals};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// Splits parameter grids into jobs for workers, stores the records and answers fits.
#[derive(Debug, Parser)]
#[command(version, after_help = EXAMPLES)]
struct Args {
    /// Address to listen on. One that other machines can reach needs --access or --insecure.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7700", env = "FARM_LISTEN")]
    listen: SocketAddr,
    /// Address for metrics and health checks over HTTP: /metrics, /livez, /readyz [default: none].
    #[arg(long, value_name = "ADDR", env = "FARM_METRICS")]
    metrics: Option<SocketAddr>,
    /// Folder for the database; it must not be on a network filesystem.
    #[arg(long, value_name = "DIR", default_value = "farm-data", env = "FARM_DATA")]
    data: PathBuf,
    /// Seconds of silence after which a worker's leases go to other workers.
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    lease: u64,
    /// Failed attempts after which a job is given up.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    max_attempts: u32,
    /// Share of the results, 0 to 1, that a second worker computes again for comparison.
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = share)]
    verify_share: f64,
    /// Largest number of connections; further ones are refused.
    #[arg(long, value_name = "N", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    max_connections: u32,
    /// Memory for the dictionaries that are fitted with, in MiB. What was not asked for longest makes room.
    #[arg(long, value_name = "MIB", default_value_t = Config::FIT_MEMORY_MIB, env = "FARM_FIT_MEMORY")]
    fit_memory: usize,
    /// Make a verified backup by itself, as in 6h or 1d [default: none].
    #[arg(long, value_name = "DURATION", env = "FARM_BACKUP_EVERY", value_parser = parse_time_limit)]
    backup_every: Option<Duration>,
    /// Scheduled backups that are kept; the oldest go.
    #[arg(long, value_name = "N", default_value_t = 7, env = "FARM_BACKUP_KEEP", value_parser = clap::value_parser!(u32).range(1..=100_000), requires = "backup_every")]
    keep: u32,
    /// Folder for scheduled backups, of this farm alone and best on another disk [default: backups, in the folder of the
    /// database].
    #[arg(long, value_name = "DIR", env = "FARM_BACKUPS", requires = "backup_every")]
    backups: Option<PathBuf>,
    /// The coordinator's access file, with its certificate and tokens; created by `farmctl access create`.
    #[arg(long, value_name = "FILE", env = "FARM_ACCESS")]
    access: Option<PathBuf>,
    /// Log format: text, or one JSON object per line. FARM_LOG sets how much is logged, as in FARM_LOG=debug.
    #[arg(long, value_name = "FORMAT", env = "FARM_LOG_FORMAT", default_value = "text")]
    log_format: LogFormat,
    /// Let everybody who reaches the address do everything, without encryption or tokens; only for networks, and users of
    /// this machine, that you trust.
    #[arg(long)]
    insecure: bool,
}

const EXAMPLES: &str = "\
Without --access it serves the user who starts it, on this machine: that user's farmctl and farm-worker get in by
themselves, nobody else does.

Examples:
  farm-coordinator                                serve ./farm-data to this machine, at http://127.0.0.1:7700
  farm-coordinator --listen 0.0.0.0:7700 --access access/coordinator.toml --data /var/lib/farm
  farm-coordinator --backup-every 6h --keep 28 --backups /mnt/backup/farm";

#[tokio::main]
async fn main() -> ExitCode {
    match run(Args::parse()).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("farm-coordinator: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn run(args: Args) -> anyhow::Result<()> {
    logs::init(args.log_format, "info")?;
    anyhow::ensure!(
        args.listen.ip().is_loopback() || args.insecure || args.access.is_some(),
        "{} can be reached from other machines, unencrypted and without a password: make access files with \
         `farmctl access create` and name the coordinator's with --access, or add --insecure if you trust the network",
        args.listen
    );
    let folder = args.backups.unwrap_or_else(|| args.data.join(DataDir::BACKUPS));
    let schedule = |every| BackupSchedule { every, keep: args.keep as usize, folder: folder.clone() };
    let config = Config {
        backups: args.backup_every.map(schedule),
        data_dir: args.data,
        lease: Duration::from_secs(args.lease),
        max_attempts: args.max_attempts,
        check_share: args.verify_share,
        max_connections: args.max_connections as usize,
        fit_memory_bytes: args.fit_memory.saturating_mul(1 << 20),
    };
    let access = args.access.as_deref().map(CoordinatorAccess::read).transpose()?.map(Arc::new);
    let coordinator = Coordinator::open(&config).await?;
    let listening = match access {
        None if !args.insecure => Gate::own_user(args.listen).await,
        access => {
            let gate = access.map_or(Gate::Everybody, Gate::File);
            TcpListener::bind(args.listen).await.map(|listener| (listener, gate))
        }
    };
    let (listener, gate) =
        listening.map_err(|error| anyhow::anyhow!("listening on {}: {error}", args.listen))?;
    let figures = match args.metrics {
        Some(address) => {
            let listener = TcpListener::bind(address).await;
            Some(listener.map_err(|error| anyhow::anyhow!("listening on {address} for figures: {error}"))?)
        }
        None => None,
    };
    let shutdown = CancellationToken::new();
    tokio::spawn(stop_on_signal(shutdown.clone()));
    Ok(coordinator.serve(listener, gate, figures, shutdown).await?)
}

fn share(text: &str) -> Result<f64, String> {
    let share = text.parse::<f64>().ok().filter(|s| (0.0..=1.0).contains(s));
    share.ok_or_else(|| "a number from 0 to 1 is needed".to_owned())
}

async fn stop_on_signal(shutdown: CancellationToken) {
    signals::termination().await;
    tracing::info!("stopping");
    shutdown.cancel();
}
