//! Implements `farmctl`: submits grids, fits measurements, simulates profiles; on one machine or with a farm.
//!
//! `docs/glossary.md` explains the terms.

#![warn(clippy::print_stdout, clippy::print_stderr, reason = "they panic where the output is full or closed")]

pub mod access_files;
mod answers;
mod cli;
mod commands;
mod connection;
#[cfg(test)]
mod damaged;
mod exit;
mod figure_files;
mod interrupt;
mod measured;
mod output;
mod prints;
mod progress;
mod renderers;
mod slurm;
#[cfg(test)]
mod testing;
mod traced;

use std::process::ExitCode;

pub use commands::Cli;
use commands::{DictionaryDeleted, NotKept};
use output::Output;

/// Runs a command. Errors are printed on standard error (or, with `--json`, as an object on standard output) and
/// reported by the exit code, see `exit`.
///
/// It contains the runtime: a future that is passed to another crate would be compiled there again, with all its
/// dependencies.
#[tokio::main]
pub async fn run(cli: Cli) -> ExitCode {
    let output = Output::new(cli.global.json);
    match cli.run(&output).await {
        Ok(code) => code,
        Err(error) if output::is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) if error.is::<DictionaryDeleted>() => {
            output.error(&error);
            ExitCode::from(exit::DELETED)
        }
        Err(error) if error.is::<NotKept>() => {
            // JSON has the reason in the answer.
            if !output.is_json() {
                output.error(&error);
            }
            ExitCode::from(exit::NOT_KEPT)
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
