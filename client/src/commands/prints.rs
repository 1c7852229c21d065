//! Commands that predict how prints of measured media look.

pub(crate) mod chart;
pub(crate) mod compare;
pub(crate) mod predict;
pub(crate) mod recipe;
pub(crate) mod translucency;
pub(crate) mod validate;
mod view_args;

use std::process::ExitCode;

use anyhow::Result;
use clap::Subcommand;

use crate::output::Output;

#[derive(Debug, Subcommand)]
pub(crate) enum PrintCommand {
    /// Predict reflectance and colour of prints of measured media, with intervals.
    Predict(predict::PredictArgs),
    /// Make a chart of stacks to print: a table and models for a slicer.
    Chart(chart::ChartArgs),
    /// Compare two measurements of resins: whether they differ, and what both together give.
    Compare(compare::CompareArgs),
    /// Validate measured media by a chart of printed patches: residuals, their expected spread, and colours.
    Validate(validate::ValidateArgs),
    /// Find the mixture of measured inks that comes closest to a colour.
    Recipe(recipe::RecipeArgs),
    /// Describe how translucent measured media are: mean free path, depth, K and S, transmission distance.
    Translucency(translucency::TranslucencyArgs),
}

impl PrintCommand {
    pub(crate) fn run(self, output: &Output) -> Result<ExitCode> {
        match self {
            Self::Predict(args) => predict::run(&args, output)?,
            Self::Chart(args) => chart::run(&args, output)?,
            Self::Compare(args) => compare::run(&args, output)?,
            Self::Validate(args) => validate::run(&args, output)?,
            Self::Recipe(args) => recipe::run(&args, output)?,
            Self::Translucency(args) => translucency::run(&args, output)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
