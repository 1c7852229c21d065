//! `farm-coordinator`: opens the port, runs the library until a signal.

#![warn(clippy::print_stdout, clippy::print_stderr, reason = "they panic where the output is full or closed")]

use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use farm_coordinator::cli::Args;
use farm_coordinator::{Config, Coordinator, Gate};
use farm_link::{CoordinatorAccess, arguments, logs, signals};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

#[tokio::main]
async fn main() -> ExitCode {
    match run(arguments::parse::<Args>()).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            logs::to_stderr(format_args!("farm-coordinator: {error}"));
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
    let defaults = Config::new(args.data);
    let config = Config {
        lease: Duration::from_secs(args.lease),
        max_attempts: args.max_attempts,
        check_share: args.verify_share,
        max_connections: args.max_connections as usize,
        fit_memory_bytes: args
            .fit_memory
            .map_or(defaults.fit_memory_bytes, |mib| mib.saturating_mul(1 << 20)),
        ..defaults
    };
    let access = args.access.as_deref().map(CoordinatorAccess::read).transpose()?.map(Arc::new);
    let coordinator = Coordinator::open(&config).await?;
    let listening = match access {
        None if !args.insecure => Gate::own_user(args.listen),
        access => {
            let gate = access.map_or(Gate::Everybody, Gate::File);
            TcpListener::bind(args.listen).await.map(|listener| (listener.into(), gate))
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

async fn stop_on_signal(shutdown: CancellationToken) {
    signals::termination().await;
    shutdown.cancel();
    tracing::info!("stopping");
}
