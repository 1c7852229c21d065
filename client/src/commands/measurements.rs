//! Commands that make, simulate, check and list measurements.

pub(crate) mod capture;
pub(crate) mod check;
pub(crate) mod kept;
pub(crate) mod simulate;

use std::process::ExitCode;

use anyhow::Result;
use clap::Subcommand;

use crate::cli::Global;
use crate::output::Output;

#[derive(Debug, Subcommand)]
pub(crate) enum MeasurementCommand {
    /// Turn the photographs of a session into edge profiles, with the quantities of the set-up.
    Capture(capture::CaptureArgs),
    /// Check a measurement file: print what is read, and refuse or note what may be wrong.
    Check(check::CheckArgs),
    /// List, show, annotate or delete the measurements that are kept with the farm.
    #[command(name = "measurements")]
    Kept(kept::KeptArgs),
    /// Simulate edge profiles, without a farm.
    Simulate(Box<simulate::SimulateArgs>),
}

impl MeasurementCommand {
    pub(crate) async fn run(self, global: &Global, output: &Output) -> Result<ExitCode> {
        match self {
            Self::Capture(args) => return capture::run(global, args, output).await,
            Self::Check(args) => check::run(&args, output)?,
            Self::Kept(args) => kept::run(global, args, output).await?,
            Self::Simulate(args) => simulate::run(*args, output).await?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
