//! Implements `farmctl scale`: finds the scale factor and the anisotropy common to a set of materials.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use farm_figures::scale_figure;
use farm_lab::measurement_file::MeasurementFile;
use farm_proto::wire::ScaleRequest;
use optics_model::fit::{Common, FitOptions, MaterialFit, ScaleCurve};
use serde::Serialize;

use super::chosen_dictionary;
use crate::answers::{MeasurementAnswer, OLDER, UsedOptions, common_blocks, scale_blocks};
use crate::cli::{FigureArgs, Global, MuArgs, OptionArgs};
use crate::connection::patient;
use crate::figure_files::{self, drawn};
use crate::output::Output;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl scale materials.csv
  farmctl scale materials.csv --g 0.4 --plot scale.svg")]
pub(crate) struct ScaleArgs {
    /// CSV with the profiles of all materials of one set-up.
    measurements: PathBuf,
    #[command(flatten)]
    options: OptionArgs,
    #[command(flatten)]
    mu: MuArgs,
    /// Draw the error over the scale factor and over g: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
}

pub(crate) async fn run(global: &Global, args: ScaleArgs, output: &Output) -> Result<()> {
    let set_up = args.options.set_up.read(None)?;
    let options = FitOptions::new(args.options.settings(&set_up)?)?;
    let range = args.mu.range()?;
    let given = args.options.dictionary.as_ref();
    chosen_dictionary::check(given)?;
    args.figure.check(args.plot.as_deref())?;
    let MeasurementFile { materials, notes } = output.read_measurements(&args.measurements)?;
    let assumed = set_up.assumed(&materials);
    let materials = set_up.apply_to(materials)?;
    let (dictionary, answer) = chosen_dictionary::ask(global, given, async |connection, dictionary| {
        let request = ScaleRequest {
            dictionary,
            materials: materials.iter().map(Into::into).collect(),
            options: Some((&options).into()),
            mu: Some(range.into()),
        };
        let mut fits = connection.fits_of("materials", &request.materials)?;
        Ok(fits.scale(patient(request)).await?.into_inner())
    })
    .await?;
    let scale = ScaleCurve::try_from(answer.scale.context("the farm's answer holds no curve")?)?;
    let common: Common = answer.common.context(OLDER)?.try_into()?;
    let fits: Vec<MaterialFit> =
        answer.materials.into_iter().map(MaterialFit::try_from).collect::<Result<_, _>>()?;
    if let Some(path) = &args.plot {
        figure_files::write(&scale_figure(&scale, &common, options.objective())?, path, args.figure.size()?)?;
    }
    let options = options.with_mu(scale.best.mu, scale.std_error.unwrap_or(0.0))?;
    let used = UsedOptions::new(&dictionary, &options, &assumed);
    let answer = ScaleJson { scale: &scale, common: &common, materials: &fits };
    let data = MeasurementAnswer { options: used, answer, notes: &notes };
    output
        .answer("scale", &data, || [common_blocks(&common), scale_blocks(&scale), drawn(&args.plot)].concat())
}

#[derive(Debug, Serialize)]
pub(crate) struct ScaleJson<'a> {
    pub(crate) scale: &'a ScaleCurve,
    /// Scale factor and anisotropy by refined fits.
    pub(crate) common: &'a Common,
    pub(crate) materials: &'a [MaterialFit],
}
