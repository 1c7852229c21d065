//! `farmctl`: submits grids, fits measurements, simulates profiles; on one machine or against a farm.

mod answers;
pub mod cli;
mod commands;
mod connection;
mod figures;
mod grid_file;
mod measurement_file;
mod media;
mod output;
mod plot;
mod progress;

use std::process::ExitCode;

use cli::{Cli, Command};
use output::Output;

pub use grid_file::{read_grid, read_scene};
pub use measurement_file::read_measurements;

/// Runs a command. Errors are told on standard error (or, with `--json`, as an object on standard output) and by the
/// exit code: 1 for an error, 3 for a dictionary with failed jobs, 130 for an interruption.
pub async fn run(cli: Cli) -> ExitCode {
    let output = Output::new(cli.global.json);
    match dispatch(cli, &output).await {
        Ok(code) => code,
        Err(error) if output::is_closed_pipe(&error) => ExitCode::SUCCESS,
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
        Command::Fit(args) => commands::fit::run(global, args, output).await?,
        Command::Scale(args) => commands::scale::run(global, args, output).await?,
        Command::Measure(args) => commands::measure::run(global, args, output).await?,
        Command::Map(args) => commands::map::run(global, args, output).await?,
        Command::Similar(args) => commands::similar::run(&args, output)?,
        Command::Simulate(args) => commands::simulate::run(args, output).await?,
        Command::Status => commands::status::run(global, output).await?,
        Command::List => commands::list::run(global, output).await?,
        Command::Show(args) => commands::show::run(global, args, output).await?,
        Command::Export(args) => commands::export::run(global, args, output).await?,
        Command::Completions(args) => commands::completions::run(&args),
    }
    Ok(ExitCode::SUCCESS)
}
