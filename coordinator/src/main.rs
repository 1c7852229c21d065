//! `farm-coordinator`: parses the command line, opens the port, runs the library until a signal.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use farm_coordinator::{Config, Coordinator};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tracing_subscriber::EnvFilter;

/// Splits parameter grids into jobs for workers, stores the records and answers fits.
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// Address to listen on. Without encryption other machines are let in only with --insecure.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7700", env = "FARM_LISTEN")]
    listen: SocketAddr,
    /// Folder of the database; not on a network filesystem.
    #[arg(long, value_name = "DIR", default_value = "farm-data", env = "FARM_DATA")]
    data: PathBuf,
    /// Seconds without a word after which a worker's leases go to others.
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    lease: u64,
    /// Failed attempts after which a job is given up.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    max_attempts: u32,
    /// Listen for other machines although nothing is encrypted and nobody is asked for a password.
    #[arg(long)]
    insecure: bool,
}

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
    let filter = EnvFilter::try_from_env("FARM_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    anyhow::ensure!(
        args.listen.ip().is_loopback() || args.insecure,
        "{} can be reached from other machines, without encryption: add --insecure if the network is trusted",
        args.listen
    );
    let config = Config {
        data_dir: args.data,
        lease: Duration::from_secs(args.lease),
        max_attempts: args.max_attempts,
    };
    let coordinator = Coordinator::open(&config).await?;
    let listener = TcpListener::bind(args.listen)
        .await
        .map_err(|error| anyhow::anyhow!("listening on {}: {error}", args.listen))?;
    let shutdown = CancellationToken::new();
    tokio::spawn(stop_on_signal(shutdown.clone()));
    Ok(coordinator.serve(listener, shutdown).await?)
}

async fn stop_on_signal(shutdown: CancellationToken) {
    use tokio::signal::unix::{SignalKind, signal};
    let Ok(mut terminate) = signal(SignalKind::terminate()) else { return };
    tokio::select! {
        _ = terminate.recv() => {}
        _ = tokio::signal::ctrl_c() => {}
    }
    tracing::info!("stopping");
    shutdown.cancel();
}
