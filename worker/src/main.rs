//! `farm-worker`: parses the command line and runs the library until a signal.

#![warn(clippy::print_stdout, clippy::print_stderr, reason = "they panic where the output is full or closed")]

use std::process::ExitCode;
use std::time::Duration;

use farm_link::{AccessError, ClientAccess, Target, arguments, logs, signals};
use farm_worker::cli::Args;
use farm_worker::{Config, Error};
use tokio_util::sync::CancellationToken;

/// Exit code if the coordinator refuses this worker, so that a restart would be useless.
const REFUSED: u8 = 4;

#[tokio::main]
async fn main() -> ExitCode {
    let args: Args = arguments::parse();
    if let Err(error) = logs::init(args.log_format, "info") {
        logs::to_stderr(format_args!("farm-worker: {error}"));
        return ExitCode::FAILURE;
    }
    let config = match config(args) {
        Ok(config) => config,
        Err(error) => {
            logs::to_stderr(format_args!("farm-worker: {error}"));
            return ExitCode::FAILURE;
        }
    };
    let shutdown = CancellationToken::new();
    tokio::spawn(stop_on_signal(shutdown.clone()));
    match farm_worker::run(config, shutdown).await {
        Ok(_) => ExitCode::SUCCESS,
        Err(error) => {
            logs::to_stderr(format_args!("farm-worker: {error}"));
            if matches!(error, Error::Refused(_)) { ExitCode::from(REFUSED) } else { ExitCode::FAILURE }
        }
    }
}

fn config(args: Args) -> Result<Config, AccessError> {
    let access = args.access.as_deref().map(ClientAccess::read).transpose()?;
    let default = access.is_none().then_some("http://127.0.0.1:7700");
    let config = Config::new(Target::new(access.as_ref(), args.server.as_deref().or(default))?);
    Ok(Config {
        threads: args.threads.map_or(config.threads, usize::from),
        label: args.label.unwrap_or(config.label),
        host: config.host,
        log: farm_worker::log_place(),
        kernel: args.kernel,
        pace: Duration::from_millis(args.pace_ms),
        time_limit: args.time_limit,
        grace: args.grace,
        idle_exit: args.idle_exit,
        buffer_bytes: (args.buffer as usize) << 20,
        coordinator: config.coordinator,
    })
}

async fn stop_on_signal(shutdown: CancellationToken) {
    signals::termination().await;
    shutdown.cancel();
    tracing::info!("stopping");
}
