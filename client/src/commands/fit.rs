use anyhow::{Context, Result};
use farm_proto::fit::{FitOptions, MaterialFit};
use farm_proto::wire::FitRequest;
use farm_proto::{DictionaryName, Measurement};
use serde::Serialize;

use crate::answers::{MaterialJson, OptionsJson, details, neighbours, table_one};
use crate::cli::{FitArgs, Global};
use crate::connection::{Connection, Purpose, with_farm};
use crate::figures;
use crate::measurement_file::{MeasurementFile, Note, read_measurements};
use crate::output::Output;
use crate::plot::Picture;

pub(crate) async fn run(global: &Global, args: FitArgs, output: &Output) -> Result<()> {
    let options = args.options()?;
    let dictionary = &args.options.dictionary;
    DictionaryName::new(dictionary.as_str()).map_err(|e| e.within("dictionary"))?;
    args.plot.as_deref().map_or(Ok(()), Picture::check_path)?;
    let MeasurementFile { materials, notes } =
        read_measurements(&args.measurement)?.told(&args.measurement, output);
    let fits = with_farm(global, Purpose::Ask, async |connection| {
        fit_all(connection, dictionary, &materials, &options).await
    })
    .await?;
    if let Some(path) = &args.plot {
        figures::write_fits(&fits, path)?;
    }
    let options = OptionsJson::new(dictionary, &options);
    let data = FitJson { options, materials: fits.iter().map(Into::into).collect(), notes };
    output.print("fit", &data, || text(&fits, args.top))
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
        let answer = connection.fits().fit(request).await;
        let answer = answer.with_context(|| format!("material {}", measurement.material()))?.into_inner();
        fits.push(answer.fit.context("the farm's answer holds no fit")?.try_into()?);
    }
    Ok(fits)
}

/// The paper's Table 1, certainty, then the best records of each channel.
fn text(fits: &[MaterialFit], top: u32) -> String {
    let mut text = table_one(fits);
    if fits.iter().flat_map(|f| &f.channels).any(|c| c.refined.is_some() || c.outside.is_some()) {
        text += "\n\n";
        text += &details(fits);
    }
    if top > 1 {
        for fit in fits {
            for channel in &fit.channels {
                text += &format!("\n\n{}, channel {}: best records\n", fit.material, channel.channel);
                text += &neighbours(&channel.candidates);
            }
        }
    }
    text
}

#[derive(Debug, Serialize)]
struct FitJson {
    #[serde(flatten)]
    options: OptionsJson,
    materials: Vec<MaterialJson>,
    /// What was assumed when the file was read, and what looks suspicious in it.
    notes: Vec<Note>,
}
