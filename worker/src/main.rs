//! `farm-worker`: parses the command line, runs the library until a signal.

use std::process::ExitCode;

use clap::Parser;
use farm_worker::Config;
use tokio_util::sync::CancellationToken;
use tracing_subscriber::EnvFilter;

/// Leases jobs from a coordinator and traces them on all cores.
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// URL of the coordinator.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:7700", env = "FARM_SERVER")]
    server: String,
    /// Threads that trace [default: all cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    threads: Option<u16>,
    /// Name that people see [default: the process number].
    #[arg(long, value_name = "TEXT")]
    label: Option<String>,
}

#[tokio::main]
async fn main() -> ExitCode {
    match run(Args::parse()).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("farm-worker: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn run(args: Args) -> Result<(), farm_worker::Error> {
    let filter = EnvFilter::try_from_env("FARM_LOG").unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    let mut config = Config::new(args.server);
    if let Some(threads) = args.threads {
        config.threads = usize::from(threads);
    }
    if let Some(label) = args.label {
        config.label = label;
    }
    let shutdown = CancellationToken::new();
    tokio::spawn(stop_on_signal(shutdown.clone()));
    farm_worker::run(config, shutdown).await
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
