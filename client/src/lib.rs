//! `farmctl`: submits grids, fits measurements, simulates profiles; on one machine or against a farm.

#![warn(clippy::print_stdout, clippy::print_stderr, reason = "they panic where the output is full or closed")]

pub mod access_files;
mod answers;
pub mod cli;
mod commands;
mod connection;
#[cfg(test)]
mod damaged;
mod exit;
mod figure_files;
mod interrupt;
mod outage;
mod output;
mod progress;
mod questions;
mod records;
mod renderers;
mod slurm;
mod terminal;
mod web;

use std::process::ExitCode;

use cli::{Cli, Command};
use output::Output;

/// Runs a command. Errors are printed on standard error (or, with `--json`, as an object on standard output) and by the
/// exit code, see `exit`.
///
/// It brings its own runtime: a future that is handed to another crate is compiled there once more, with all that it
/// waits for.
#[tokio::main]
pub async fn run(cli: Cli) -> ExitCode {
    let output = Output::new(cli.global.json);
    match dispatch(cli, &output).await {
        Ok(code) => code,
        Err(error) if output::is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) if error.is::<commands::Deleted>() => {
            output.error(&error);
            ExitCode::from(exit::DELETED)
        }
        Err(error) if error.is::<interrupt::Interrupted>() => {
            output.error(&error);
            ExitCode::from(exit::INTERRUPTED)
        }
        Err(error) => {
            output.error(&error);
            ExitCode::FAILURE
        }
    }
}

async fn dispatch(cli: Cli, output: &Output) -> anyhow::Result<ExitCode> {
    let global = &cli.global;
    match cli.command {
        Command::Submit(args) => return commands::submit::run(global, args, output).await,
        Command::Capture(args) => return commands::capture::run(global, args, output).await,
        Command::Check(args) => commands::check::run(&args, output)?,
        Command::Fit(args) => commands::fit::run(global, args, output).await?,
        Command::Scale(args) => commands::scale::run(global, args, output).await?,
        Command::Measure(args) => {
            let inputs = commands::measure::Inputs::of(args)?;
            commands::measure::run(global, inputs, output).await?;
        }
        Command::Map(args) => commands::map::run(global, args, output).await?,
        Command::Design(args) => commands::design::run(global, args, output).await?,
        Command::Profile(args) => commands::profile::run(global, args, output).await?,
        Command::Similar(args) => commands::similar::run(&args, output)?,
        Command::Simulate(args) => commands::simulate::run(args, output).await?,
        Command::Web(args) => web::run(global, args, output).await?,
        Command::Serve(args) => commands::serve::run(global, &args, output).await?,
        Command::Status => commands::status::run(global, output).await?,
        Command::List => commands::list::run(global, output).await?,
        Command::Watch(args) => return commands::watch::watch(global, &args.name, output).await,
        Command::Wait(args) => return commands::watch::wait(global, args, output).await,
        Command::Explain(args) => commands::explain::run(global, &args.name, output).await?,
        Command::Pause(args) => commands::manage::pause(global, &args.name, output).await?,
        Command::Resume(args) => commands::manage::resume(global, &args.name, output).await?,
        Command::Cancel(args) => commands::manage::cancel(global, args, output).await?,
        Command::Retry(args) => commands::manage::retry(global, &args.name, output).await?,
        Command::Priority(args) => commands::manage::priority(global, args, output).await?,
        Command::Delete(args) => commands::manage::delete(global, args, output).await?,
        Command::Workers(args) => commands::workers::run(global, args, output).await?,
        Command::Events(args) => commands::events::run(global, args, output).await?,
        Command::Doctor(args) => return commands::doctor::run(global, &args, output).await,
        Command::Backup(args) => commands::backup::backup(global, args, output).await?,
        Command::Restore(args) => commands::backup::restore(global, args, output).await?,
        Command::Access(command) => commands::access::run(command, output)?,
        Command::Slurm(command) => commands::slurm::run(global, command, output).await?,
        Command::Health => commands::health::run(global, output).await?,
        Command::Show(args) => commands::show::run(global, args, output).await?,
        Command::Export(args) => commands::export::run(global, args, output).await?,
        Command::Completions(args) => commands::completions::run(&args)?,
        Command::Manual(args) => commands::manual::run(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}
