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
mod output;
mod progress;
mod renderers;
mod slurm;
mod web;

use std::process::ExitCode;

use cli::{Cli, Command};
use commands::{dictionaries, farm, fits, measurements};
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
        Err(error) if error.is::<dictionaries::DictionaryDeleted>() => {
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
        Command::Submit(args) => return dictionaries::submit::run(global, args, output).await,
        Command::Capture(args) => return measurements::capture::run(global, args, output).await,
        Command::Check(args) => measurements::check::run(&args, output)?,
        Command::Fit(args) => fits::fit::run(global, args, output).await?,
        Command::Scale(args) => fits::scale::run(global, args, output).await?,
        Command::Measure(args) => {
            let inputs = fits::measure::Inputs::of(args)?;
            fits::measure::run(global, inputs, output).await?;
        }
        Command::Map(args) => fits::map::run(global, args, output).await?,
        Command::Design(args) => fits::design::run(global, args, output).await?,
        Command::Profile(args) => fits::profile::run(global, args, output).await?,
        Command::Similar(args) => fits::similar::run(&args, output)?,
        Command::Simulate(args) => measurements::simulate::run(args, output).await?,
        Command::Web(args) => web::run(global, args, output).await?,
        Command::Serve(args) => farm::serve::run(global, &args, output).await?,
        Command::Status => farm::status::run(global, output).await?,
        Command::List => dictionaries::list::run(global, output).await?,
        Command::Watch(args) => return dictionaries::watch::watch(global, &args.name, output).await,
        Command::Wait(args) => return dictionaries::watch::wait(global, args, output).await,
        Command::Explain(args) => dictionaries::explain::run(global, &args.name, output).await?,
        Command::Pause(args) => dictionaries::manage::pause(global, &args.name, output).await?,
        Command::Resume(args) => dictionaries::manage::resume(global, &args.name, output).await?,
        Command::Cancel(args) => dictionaries::manage::cancel(global, args, output).await?,
        Command::Retry(args) => dictionaries::manage::retry(global, &args.name, output).await?,
        Command::Priority(args) => dictionaries::manage::priority(global, args, output).await?,
        Command::Delete(args) => dictionaries::manage::delete(global, args, output).await?,
        Command::Workers(args) => farm::workers::run(global, args, output).await?,
        Command::Events(args) => farm::events::run(global, args, output).await?,
        Command::Doctor(args) => return farm::doctor::run(global, &args, output).await,
        Command::Backup(args) => farm::backup::backup(global, args, output).await?,
        Command::Restore(args) => farm::backup::restore(global, args, output).await?,
        Command::Access(command) => farm::access::run(command, output)?,
        Command::Slurm(command) => commands::slurm::run(global, command, output).await?,
        Command::Health => farm::health::run(global, output).await?,
        Command::Show(args) => dictionaries::show::run(global, args, output).await?,
        Command::Export(args) => dictionaries::export::run(global, args, output).await?,
        Command::Completions(args) => commands::completions::run(&args)?,
        Command::Manual(args) => commands::manual::run(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}
