use anyhow::{Context, Result, bail};
use farm_proto::wire::MapRequest;
use optics_model::Measurement;
use optics_model::fit::{DistanceMap, FitOptions, FitSettings, MapLayer};
use serde::Serialize;

use super::which;
use crate::answers::{CandidateJson, OptionsJson, albedo, significant};
use crate::cli::{Global, MapArgs};
use crate::connection::{Connection, Purpose, with_farm};
use crate::figures;
use crate::measurement_file::{MeasurementFile, Note, read_measurements};
use crate::output::{Output, table};
use crate::plot::Picture;

pub(crate) async fn run(global: &Global, args: MapArgs, output: &Output) -> Result<()> {
    let options = FitOptions::new(FitSettings { mu: args.mu, ..args.options.settings()? })?;
    let given = args.options.dictionary.as_ref();
    which::check(given)?;
    args.plot.as_deref().map_or(Ok(()), Picture::check_path)?;
    let MeasurementFile { materials, notes } =
        read_measurements(&args.measurement)?.told(&args.measurement, output);
    let materials = chosen(materials, &args)?;
    let (dictionary, maps) = with_farm(global, Purpose::Ask, async |connection| {
        let dictionary = which::dictionary(connection, given).await?;
        let maps = map_all(connection, &dictionary, &materials, &options).await?;
        Ok((dictionary, maps))
    })
    .await?;
    if let Some(path) = &args.plot {
        figures::write_maps(&maps, path)?;
    }
    let data = data(&dictionary, &options, &maps, notes);
    output.print("map", &data, || {
        let tell = |(material, map): &(String, DistanceMap)| text(material, map);
        maps.iter().map(tell).collect::<Vec<_>>().join("\n\n")
    })
}

/// The materials and channels that were asked for.
fn chosen(materials: Vec<Measurement>, args: &MapArgs) -> Result<Vec<Measurement>> {
    let names: Vec<String> = materials.iter().map(|m| m.material().to_owned()).collect();
    let wanted = |m: &Measurement| args.material.as_deref().is_none_or(|name| name == m.material());
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
) -> Result<Vec<(String, DistanceMap)>> {
    let mut maps = Vec::new();
    for measurement in materials {
        let request = MapRequest {
            dictionary: dictionary.to_owned(),
            measurement: Some(measurement.into()),
            options: Some(options.into()),
        };
        let answer = connection.fits().map(request).await;
        let answer = answer.with_context(|| format!("material {}", measurement.material()))?.into_inner();
        for map in answer.maps {
            maps.push((measurement.material().to_owned(), DistanceMap::try_from(map)?));
        }
    }
    Ok(maps)
}

/// One row an anisotropy: its best medium, and what similarity theory predicts from the best of all.
fn text(material: &str, map: &DistanceMap) -> String {
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
    let head = ["g", "σ_t /mm", "α", "error", "similar to best\nσ_t /mm", "similar to best\nα"];
    let rows = map.layers.iter().enumerate().map(row);
    format!("{material}, channel {}\n{}", map.channel, table(&head, &[0, 1, 2, 3, 4, 5], rows))
}

pub(super) fn data(
    dictionary: &str,
    options: &FitOptions,
    maps: &[(String, DistanceMap)],
    notes: Vec<Note>,
) -> JsonData {
    let json = |(material, map): &(String, DistanceMap)| MapJson::new(material, map);
    let options = OptionsJson::new(dictionary, options);
    JsonData { options, maps: maps.iter().map(json).collect(), notes }
}

#[derive(Debug, Serialize)]
pub(super) struct JsonData {
    #[serde(flatten)]
    options: OptionsJson,
    maps: Vec<MapJson>,
    /// What was assumed when the file was read, and what looks suspicious in it.
    notes: Vec<Note>,
}

#[derive(Debug, Serialize)]
struct MapJson {
    material: String,
    channel: String,
    sigma_t_per_mm: Vec<f64>,
    albedo: Vec<f64>,
    sample_ior: f64,
    best_layer: usize,
    layers: Vec<LayerJson>,
}

#[derive(Debug, Serialize)]
struct LayerJson {
    g: f64,
    /// `[sigma_t][albedo]`.
    errors: Vec<Vec<f64>>,
    best: CandidateJson,
    similar: Option<SimilarJson>,
}

#[derive(Debug, Serialize)]
struct SimilarJson {
    sigma_t_per_mm: f64,
    albedo: f64,
}

impl MapJson {
    fn new(material: &str, map: &DistanceMap) -> Self {
        let layer = |l: &MapLayer| LayerJson {
            g: l.g,
            errors: l.errors.chunks(map.albedo.len().max(1)).map(<[f64]>::to_vec).collect(),
            best: (&l.best).into(),
            similar: l
                .similar
                .map(|m| SimilarJson { sigma_t_per_mm: m.sigma_t_per_mm(), albedo: m.albedo() }),
        };
        Self {
            material: material.to_owned(),
            channel: map.channel.clone(),
            sigma_t_per_mm: map.sigma_t_per_mm.clone(),
            albedo: map.albedo.clone(),
            sample_ior: map.sample_ior,
            best_layer: map.best_layer,
            layers: map.layers.iter().map(layer).collect(),
        }
    }
}
