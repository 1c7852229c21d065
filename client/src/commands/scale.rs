use anyhow::{Context, Result};
use farm_proto::wire::ScaleRequest;
use optics_model::fit::{Common, FitOptions, MaterialFit, ScaleCurve};
use serde::Serialize;

use super::measure::OLDER;
use super::which;
use crate::answers::{CommonJson, MaterialJson, OptionsJson, ScaleJson, common_text, scale_text};
use crate::cli::{Global, ScaleArgs};
use crate::connection::{Purpose, with_farm};
use crate::figures::{self, drawn};
use crate::measurement_file::{MeasurementFile, Note, read_measurements};
use crate::output::Output;
use crate::plot::Picture;

pub(crate) async fn run(global: &Global, args: ScaleArgs, output: &Output) -> Result<()> {
    let options = FitOptions::new(args.options.settings()?)?;
    let range = args.mu.range()?;
    let given = args.options.dictionary.as_ref();
    which::check(given)?;
    args.plot.as_deref().map_or(Ok(()), Picture::check_path)?;
    let MeasurementFile { materials, notes } =
        read_measurements(&args.measurements)?.told(&args.measurements, output);
    let (dictionary, answer) = with_farm(global, Purpose::Ask, async |connection| {
        let dictionary = which::dictionary(connection, given).await?;
        let request = ScaleRequest {
            dictionary: dictionary.clone(),
            materials: materials.iter().map(Into::into).collect(),
            options: Some((&options).into()),
            mu: Some(range.into()),
        };
        Ok((dictionary, connection.fits().scale(request).await?.into_inner()))
    })
    .await?;
    let scale = ScaleCurve::try_from(answer.scale.context("the farm's answer holds no curve")?)?;
    let common: Common = answer.common.context(OLDER)?.try_into()?;
    let fits: Vec<MaterialFit> =
        answer.materials.into_iter().map(MaterialFit::try_from).collect::<Result<_, _>>()?;
    if let Some(path) = &args.plot {
        figures::scale(&scale, &common)?.write(path)?;
    }
    let options = options.with_mu(scale.best.mu, scale.std_error.unwrap_or(0.0))?;
    let data = data(&dictionary, &options, &scale, &common, &fits, notes);
    output.print("scale", &data, || {
        format!("{}\n\n{}{}", common_text(&common), scale_text(&scale), drawn(args.plot.as_deref()))
    })
}

pub(super) fn data(
    dictionary: &str,
    options: &FitOptions,
    scale: &ScaleCurve,
    common: &Common,
    fits: &[MaterialFit],
    notes: Vec<Note>,
) -> JsonData {
    JsonData {
        options: OptionsJson::new(dictionary, options),
        scale: scale.into(),
        common: common.into(),
        materials: fits.iter().map(Into::into).collect(),
        notes,
    }
}

#[derive(Debug, Serialize)]
pub(super) struct JsonData {
    #[serde(flatten)]
    options: OptionsJson,
    scale: ScaleJson,
    /// By the errors of refined fits.
    common: CommonJson,
    materials: Vec<MaterialJson>,
    /// What was assumed when the file was read, and what looks suspicious in it.
    notes: Vec<Note>,
}
