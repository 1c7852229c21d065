//! Implements `farmctl fit`: finds the media that best explain the profiles of each material, with error bars.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use farm_lab::document::Block;
use farm_lab::measurement_file::MeasurementFile;
use farm_lab::set_up::SetUp;
use farm_proto::wire::FitRequest;
use optics_model::Measurement;
use optics_model::fit::{FitOptions, FitSettings, MaterialFit};
use serde::Serialize;

use super::chosen_dictionary;
use crate::answers::{FitsReport, MeasurementAnswer, UsedOptions, fits_blocks, neighbours};
use crate::cli::set_up::SET_UP;
use crate::cli::{FigureArgs, Global, OptionArgs};
use crate::connection::{Connection, patient};
use crate::figure_files::{self, drawn};
use crate::output::Output;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl fit examples/white.csv
  farmctl fit examples/white.csv --g 0.4 --top 3 --plot fit.svg
  farmctl fit wax.csv --dictionary fine --sigma-t 4..8
  farmctl fit wax.csv --session session.json --thickness-std-error-mm 0.002 --bound")]
pub(crate) struct FitArgs {
    /// CSV with columns material, channel, thickness_mm, x_mm, value and, if known, std_error and the set-up.
    measurement: PathBuf,
    #[command(flatten)]
    options: OptionArgs,
    /// Factor on the measured values, μ.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true, help_heading = SET_UP)]
    mu: f64,
    /// Standard error of that factor, which goes into the error bars.
    #[arg(long, value_name = "ERROR", default_value_t = 0.0, allow_negative_numbers = true, help_heading = SET_UP)]
    mu_std_error: f64,
    /// Number of best records to show per channel.
    #[arg(long, value_name = "N", default_value_t = 5)]
    top: u32,
    /// Report only records of the dictionary: no optimum between them, no error bars.
    #[arg(long)]
    no_refine: bool,
    /// Compare the intervals with the Cramér–Rao bound: the least errors that these pixels allow.
    #[arg(long, conflicts_with = "no_refine")]
    bound: bool,
    /// Draw profiles and gradients with their fits, one figure per material: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
}

impl FitArgs {
    fn options(&self, set_up: &SetUp) -> optics_model::Result<FitOptions> {
        FitOptions::new(FitSettings {
            mu: self.mu,
            mu_std_error: self.mu_std_error,
            top: self.top,
            refine: !self.no_refine,
            curves: self.plot.is_some(),
            ..self.options.settings(set_up)?
        })
    }
}

pub(crate) async fn run(global: &Global, args: FitArgs, output: &Output) -> Result<()> {
    let set_up = args.options.set_up.read(None)?;
    let options = args.options(&set_up)?;
    let given = args.options.dictionary.as_ref();
    chosen_dictionary::check(given)?;
    args.figure.check(args.plot.as_deref())?;
    let MeasurementFile { materials, notes } = output.read_measurements(&args.measurement)?;
    let assumed = set_up.assumed(&materials);
    let materials = set_up.apply_to(materials)?;
    let (dictionary, fits) = chosen_dictionary::ask(global, given, async |connection, dictionary| {
        fit_all(connection, &dictionary, &materials, &options).await
    })
    .await?;
    let pictures = match &args.plot {
        Some(path) => figure_files::write_fits(&fits, path, args.figure.size()?)?,
        None => Vec::new(),
    };
    let used = UsedOptions::new(&dictionary, &options, &assumed);
    let data = MeasurementAnswer { options: used, answer: FitJson { materials: &fits }, notes: &notes };
    output.answer("fit", &data, || {
        let assumed = assumed.text(options.settings());
        let report = FitsReport { fits: &fits, assumed, bound: args.bound, scene: true };
        [blocks(&report, args.top), drawn(&pictures)].concat()
    })
}

#[derive(Debug, Serialize)]
pub(crate) struct FitJson<'a> {
    pub(crate) materials: &'a [MaterialFit],
}

async fn fit_all(
    connection: &Connection,
    dictionary: &str,
    materials: &[Measurement],
    options: &FitOptions,
) -> Result<Vec<MaterialFit>> {
    let mut fits = Vec::new();
    for measurement in materials {
        let request = FitRequest {
            dictionary: dictionary.to_owned(),
            measurement: Some(measurement.into()),
            options: Some(options.into()),
        };
        let material = || format!("material {}", measurement.material());
        let client = connection.fits_of("measurement", request.measurement.as_slice());
        let answer =
            client.with_context(material)?.fit(patient(request)).await.with_context(material)?.into_inner();
        fits.push(answer.fit.context("the farm's answer holds no fit")?.try_into()?);
    }
    Ok(fits)
}

/// The fits, then the best records of each channel.
fn blocks(report: &FitsReport, top: u32) -> Vec<Block> {
    let mut blocks = fits_blocks(report);
    let channels = report.fits.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c)));
    for (fit, channel) in channels.filter(|_| top > 1) {
        let title = format!("{}, channel {}: best records", fit.material, channel.channel);
        blocks.extend([Block::Heading(3, title), neighbours(&channel.candidates)]);
    }
    blocks
}
