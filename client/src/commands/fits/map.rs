//! Implements `farmctl map`: maps how far measured profiles are from every medium of a dictionary.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_figures::numbers::{albedo, significant};
use farm_lab::document::{Block, ValueTable};
use farm_lab::measurement_file::{MeasurementFile, normal};
use farm_proto::wire::MapRequest;
use optics_model::Measurement;
use optics_model::fit::{DistanceMap, FitOptions, FitSettings, MapLayer};
use serde::Serialize;

use super::chosen_dictionary;
use crate::answers::{MeasurementAnswer, UsedOptions};
use crate::cli::set_up::SET_UP;
use crate::cli::{FigureArgs, Global, OptionArgs};
use crate::connection::{Connection, patient};
use crate::figure_files;
use crate::output::Output;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl map examples/white.csv --plot map.png
  farmctl map examples/white.csv --channel R --g 0.4")]
pub(crate) struct MapArgs {
    /// CSV with columns material, channel, thickness_mm, x_mm, value and, if known, std_error and the set-up.
    measurement: PathBuf,
    #[command(flatten)]
    options: OptionArgs,
    /// Factor on the measured values, μ.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true, help_heading = SET_UP)]
    mu: f64,
    /// Only this material [default: all].
    #[arg(long, value_name = "NAME")]
    material: Option<String>,
    /// Only this channel [default: all].
    #[arg(long, value_name = "NAME")]
    channel: Option<String>,
    /// Draw the maps, one picture per material and channel: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
}

pub(crate) async fn run(global: &Global, args: MapArgs, output: &Output) -> Result<()> {
    let set_up = args.options.set_up.read(None)?;
    let options = FitOptions::new(FitSettings { mu: args.mu, ..args.options.settings(&set_up)? })?;
    let given = args.options.dictionary.as_ref();
    chosen_dictionary::check(given)?;
    args.figure.check(args.plot.as_deref())?;
    let MeasurementFile { materials, notes } = output.read_measurements(&args.measurement)?;
    let materials = chosen(materials, &args)?;
    let assumed = set_up.assumed(&materials);
    let materials = set_up.apply_to(materials)?;
    let (dictionary, maps) = chosen_dictionary::ask(global, given, async |connection, dictionary| {
        map_all(connection, &dictionary, &materials, &options).await
    })
    .await?;
    let pictures = match &args.plot {
        Some(path) => {
            let maps: Vec<_> = maps.iter().map(|m| (m.material.as_str(), &m.map)).collect();
            figure_files::write_maps(&maps, path, args.figure.size()?)?
        }
        None => Vec::new(),
    };
    let used = UsedOptions::new(&dictionary, &options, &assumed);
    let data = MeasurementAnswer { options: used, answer: MapJson { maps: &maps }, notes: &notes };
    output
        .answer("map", &data, || maps.iter().flat_map(blocks).chain(figure_files::drawn(&pictures)).collect())
}

/// The requested materials and channels.
fn chosen(materials: Vec<Measurement>, args: &MapArgs) -> Result<Vec<Measurement>> {
    let names: Vec<String> = materials.iter().map(|m| m.material().to_owned()).collect();
    let wanted = |m: &Measurement| args.material.as_deref().is_none_or(|name| normal(name) == m.material());
    let mut found = Vec::new();
    for material in materials.into_iter().filter(wanted) {
        let profiles = material.profiles().iter();
        let profiles = profiles.filter(|p| args.channel.as_deref().is_none_or(|c| c == p.channel()));
        let profiles: Vec<_> = profiles.cloned().collect();
        if profiles.is_empty() {
            let channel = args.channel.as_deref().unwrap_or_default();
            bail!(
                "material {} has no channel {channel}; it has {}",
                material.material(),
                material.channels().join(", ")
            );
        }
        found.push(Measurement::new(material.material(), profiles)?);
    }
    if found.is_empty() {
        let name = args.material.as_deref().unwrap_or_default();
        bail!("the file has no material {name}; it has {}", names.join(", "));
    }
    Ok(found)
}

async fn map_all(
    connection: &Connection,
    dictionary: &str,
    materials: &[Measurement],
    options: &FitOptions,
) -> Result<Vec<MaterialMap>> {
    let mut maps = Vec::new();
    for measurement in materials {
        let request = MapRequest {
            dictionary: dictionary.to_owned(),
            measurement: Some(measurement.into()),
            options: Some(options.into()),
            board: Vec::new(),
        };
        let material = || format!("material {}", measurement.material());
        let client = connection.fits_of("measurement", request.measurement.as_slice());
        let answer =
            client.with_context(material)?.map(patient(request)).await.with_context(material)?.into_inner();
        for map in answer.maps {
            let material = measurement.material().to_owned();
            maps.push(MaterialMap { material, map: DistanceMap::try_from(map)? });
        }
    }
    Ok(maps)
}

/// One row per anisotropy: its best medium, and the prediction of similarity theory from the best of all.
fn blocks(MaterialMap { material, map }: &MaterialMap) -> [Block; 2] {
    let row = |(i, layer): (usize, &MapLayer)| {
        let best = &layer.best.medium;
        let mut row = vec![
            format!("{}{}", layer.g, if i == map.best_layer { " (best)" } else { "" }),
            best.sigma_t_per_mm().to_string(),
            best.albedo().to_string(),
            format!("{:.5}", layer.best.error),
        ];
        match &layer.similar {
            Some(m) => row.extend([significant(m.sigma_t_per_mm(), 3), albedo(m.albedo())]),
            None => row.extend(["–".to_owned(), "–".to_owned()]),
        }
        row
    };
    let head = ">g | >σ_t /mm | >α | >error | >similar to best\nσ_t /mm | >similar to best\nα";
    let title = Block::Heading(3, format!("{material}, channel {}", map.channel));
    [title, ValueTable::new(head, map.layers.iter().enumerate().map(row)).block()]
}

/// A map with its material.
#[derive(Debug, Serialize)]
pub(crate) struct MaterialMap {
    pub(crate) material: String,
    #[serde(flatten)]
    pub(crate) map: DistanceMap,
}

#[derive(Debug, Serialize)]
pub(crate) struct MapJson<'a> {
    pub(crate) maps: &'a [MaterialMap],
}
