//! Commands that predict how prints of measured media look.

mod geometry;
mod media;
pub(crate) mod predict;
mod slabs;

use std::process::ExitCode;

use anyhow::Result;
use clap::Subcommand;

use crate::output::Output;

#[derive(Debug, Subcommand)]
pub(crate) enum PrintCommand {
    /// Predict reflectance and colour of prints of measured media, with intervals.
    Predict(predict::PredictArgs),
}

impl PrintCommand {
    pub(crate) fn run(self, output: &Output) -> Result<ExitCode> {
        match self {
            Self::Predict(args) => predict::run(&args, output)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
