use anyhow::{Context, Result};
use farm_proto::DictionaryName;
use farm_proto::fit::{FitOptions, MaterialFit, ScaleCurve};
use farm_proto::wire::ScaleRequest;
use serde::Serialize;

use crate::answers::{MaterialJson, OptionsJson, ScaleJson, scale_text, table_one};
use crate::cli::{Global, ScaleArgs};
use crate::connection::{Purpose, with_farm};
use crate::figures;
use crate::measurement_file::{MeasurementFile, Note, read_measurements};
use crate::output::Output;
use crate::plot::Picture;

pub(crate) async fn run(global: &Global, args: ScaleArgs, output: &Output) -> Result<()> {
    let options = FitOptions::new(args.options.settings()?)?;
    let range = args.mu.range()?;
    let dictionary = &args.options.dictionary;
    DictionaryName::new(dictionary.as_str()).map_err(|e| e.within("dictionary"))?;
    args.plot.as_deref().map_or(Ok(()), Picture::check_path)?;
    let MeasurementFile { materials, notes } =
        read_measurements(&args.measurements)?.told(&args.measurements, output);
    let answer = with_farm(global, Purpose::Ask, async |connection| {
        let request = ScaleRequest {
            dictionary: dictionary.clone(),
            materials: materials.iter().map(Into::into).collect(),
            options: Some((&options).into()),
            mu: Some(range.into()),
        };
        Ok(connection.fits().scale(request).await?.into_inner())
    })
    .await?;
    let scale = ScaleCurve::try_from(answer.scale.context("the farm's answer holds no curve")?)?;
    let fits: Vec<MaterialFit> =
        answer.materials.into_iter().map(MaterialFit::try_from).collect::<Result<_, _>>()?;
    if let Some(path) = &args.plot {
        figures::scale(&scale)?.write(path)?;
    }
    let options = options.with_mu(scale.best.mu, scale.std_error.unwrap_or(0.0))?;
    let data = JsonData {
        options: OptionsJson::new(dictionary, &options),
        scale: (&scale).into(),
        materials: fits.iter().map(Into::into).collect(),
        notes,
    };
    output.print("scale", &data, || format!("{}\n\n{}", scale_text(&scale), table_one(&fits)))
}

#[derive(Debug, Serialize)]
struct JsonData {
    #[serde(flatten)]
    options: OptionsJson,
    scale: ScaleJson,
    materials: Vec<MaterialJson>,
    /// What was assumed when the file was read, and what looks suspicious in it.
    notes: Vec<Note>,
}
