//! Commands that answer questions about media from a dictionary.

mod chosen_dictionary;
pub(crate) mod design;
mod dictionary_notes;
pub(crate) mod fit;
pub(crate) mod map;
pub(crate) mod measure;
pub(crate) mod profile;
pub(crate) mod scale;
pub(crate) mod similar;

use std::process::ExitCode;

use anyhow::Result;
use clap::Subcommand;

use crate::cli::Global;
use crate::output::Output;

#[derive(Debug, Subcommand)]
pub(crate) enum FitCommand {
    /// Find the media that best explain measured edge profiles, with error bars.
    Fit(fit::FitArgs),
    /// Find the scale factor and the anisotropy common to a set of materials.
    Scale(scale::ScaleArgs),
    /// Measure a set of materials: scale factor, common anisotropy, and media with error bars.
    Measure(Box<measure::MeasureArgs>),
    /// Map how far measured profiles are from every medium of a dictionary.
    Map(map::MapArgs),
    /// Compare sets of slabs by how well photographs of them would determine a medium.
    Design(design::DesignArgs),
    /// Predict the profile of a slab of a medium from a dictionary, at its records and between them.
    Profile(profile::ProfileArgs),
    /// List the media that similarity theory considers equivalent to a given one.
    Similar(similar::SimilarArgs),
}

impl FitCommand {
    pub(crate) async fn run(self, global: &Global, output: &Output) -> Result<ExitCode> {
        match self {
            Self::Fit(args) => fit::run(global, args, output).await?,
            Self::Scale(args) => scale::run(global, args, output).await?,
            Self::Measure(args) => measure::measured(global, *args, output).await?,
            Self::Map(args) => map::run(global, args, output).await?,
            Self::Design(args) => design::run(global, args, output).await?,
            Self::Profile(args) => profile::run(global, args, output).await?,
            Self::Similar(args) => similar::run(&args, output)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
