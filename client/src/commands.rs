//! The verbs of `farmctl`, by subject: each module has the arguments, the examples and the work of one verb.

mod completions;
mod dictionaries;
mod farm;
mod fits;
mod manual;
mod measurements;
mod prints;
mod slurm;
#[cfg(test)]
mod tests;
mod web;

use std::ffi::OsString;
use std::process::ExitCode;

use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};

use crate::cli::{Global, help};
use crate::output::Output;
pub(crate) use dictionaries::DictionaryDeleted;
pub(crate) use fits::measure::NotKept;

/// Measures the optical parameters of translucent resins: computes dictionaries of simulated edge profiles and fits
/// measured profiles to them.
///
/// Without --server or --access everything runs in this process, with its data in ./farm-data.
#[derive(Debug, Parser)]
#[command(name = "farmctl", version, after_help = EXAMPLES)]
pub struct Cli {
    #[command(flatten)]
    pub(crate) global: Global,
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  farmctl capture session.toml --measure       from photographs to media
  farmctl submit                               compute the paper's dictionary here
  farmctl measure examples/white.csv --mu 1    measure a material with it
  farmctl fit examples/white.csv --g 0.4       see the best fits one by one
  farmctl simulate --sigma-t 6 --albedo 0.9991 --g 0.4 --thickness 0.5 > profile.csv

Exit codes: 0 success, 1 error, 2 wrong usage, 130 interrupted; for a dictionary: 3 some jobs
failed, 4 some are in quarantine, 5 cancelled, 6 still running when --timeout ran out, 7 results of
some jobs are disputed, 8 deleted while it was waited for; 9 an answer that could not be kept.";

#[derive(Debug, Subcommand)]
enum Command {
    #[command(flatten)]
    Measurements(measurements::MeasurementCommand),
    #[command(flatten)]
    Fits(fits::FitCommand),
    #[command(flatten)]
    Prints(prints::PrintCommand),
    #[command(flatten)]
    Dictionaries(dictionaries::DictionaryCommand),
    /// Open a page in the browser: measure, look at dictionaries, run the farm, judge captures.
    Web(web::WebArgs),
    #[command(flatten)]
    Farm(farm::FarmCommand),
    /// Run workers on a Slurm cluster.
    #[command(subcommand)]
    Slurm(slurm::SlurmCommand),
    /// Print completions for a shell.
    Completions(completions::CompletionsArgs),
    /// Write the manual pages of farmctl, farm-coordinator and farm-worker.
    Manual(manual::ManualArgs),
}

impl Cli {
    /// The command whose help is that for these arguments.
    pub fn with_help(mut arguments: impl Iterator<Item = OsString>) -> clap::Command {
        let all = arguments.any(|argument| argument == help::HELP_ALL);
        help::with_help(<Self as CommandFactory>::command(), all)
    }

    pub(crate) async fn run(self, output: &Output) -> Result<ExitCode> {
        let global = &self.global;
        match self.command {
            Command::Measurements(command) => return command.run(global, output).await,
            Command::Fits(command) => return command.run(global, output).await,
            Command::Prints(command) => return command.run(output),
            Command::Dictionaries(command) => return command.run(global, output).await,
            Command::Web(args) => web::run(global, args, output).await?,
            Command::Farm(command) => return command.run(global, output).await,
            Command::Slurm(command) => slurm::run(global, command, output).await?,
            Command::Completions(args) => completions::run(&args)?,
            Command::Manual(args) => manual::run(&args)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
