//! Implements `farmctl check`: prints how a measurement file is read, and what may be wrong with it.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use farm_lab::document::{Block, ValueTable};
use farm_lab::measurement_file::{MeasurementFile, Note, beyond_limits, read_measurements};
use optics_model::measurement::ProfileSetup;
use optics_model::{MeasuredProfile, Measurement};
use serde::{Serialize, Serializer};

use crate::output::Output;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl check examples/white.csv
  farmctl check wax.csv --json")]
pub(crate) struct CheckArgs {
    /// CSV with measured profiles.
    measurements: PathBuf,
}

pub(crate) fn run(args: &CheckArgs, output: &Output) -> Result<()> {
    let mut file = read_measurements(&args.measurements)?;
    file.notes.extend(beyond_limits(&file.materials));
    output.notes(&file.notes, &args.measurements);
    output.answer("check", &data(&file), || blocks(&file))
}

#[derive(Debug, Serialize)]
pub(crate) struct CheckJson<'a> {
    materials: Vec<MaterialJson<'a>>,
    notes: &'a [Note],
}

#[derive(Debug, Serialize)]
struct MaterialJson<'a> {
    material: &'a str,
    profiles: Vec<CheckedProfileJson<'a>>,
}

impl<'a> From<&'a Measurement> for MaterialJson<'a> {
    fn from(measurement: &'a Measurement) -> Self {
        let profiles = measurement.profiles().iter().map(Into::into).collect();
        Self { material: measurement.material(), profiles }
    }
}

#[derive(Debug, Serialize)]
struct CheckedProfileJson<'a> {
    channel: &'a str,
    thickness_mm: f64,
    x_mm: &'a [f64],
    values: &'a [f64],
    std_errors: Option<&'a [f64]>,
    #[serde(flatten)]
    set_up: ProfileSetupJson<'a>,
}

impl<'a> From<&'a MeasuredProfile> for CheckedProfileJson<'a> {
    fn from(profile: &'a MeasuredProfile) -> Self {
        Self {
            channel: profile.channel(),
            thickness_mm: profile.thickness_mm(),
            x_mm: profile.x_mm(),
            values: profile.values(),
            std_errors: profile.std_errors(),
            set_up: ProfileSetupJson(profile.setup()),
        }
    }
}

/// The quantities of a profile's set-up by their names.
#[derive(Debug)]
struct ProfileSetupJson<'a>(&'a ProfileSetup);

impl Serialize for ProfileSetupJson<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.values().map(|(quantity, value)| (quantity.name, value)))
    }
}

pub(crate) fn data(file: &MeasurementFile) -> CheckJson<'_> {
    CheckJson { materials: file.materials.iter().map(Into::into).collect(), notes: &file.notes }
}

fn blocks(file: &MeasurementFile) -> Vec<Block> {
    let rows = file.materials.iter().flat_map(|m| m.profiles().iter().map(move |p| row(m.material(), p)));
    let head = "material | channel | >thickness / mm | >pixels | x / mm | values | errors";
    let verdict = match file.notes.len() {
        0 => "nothing is wrong with it that can be seen".to_owned(),
        1 => "1 note, above; all else is as it should be".to_owned(),
        n => format!("{n} notes, above; all else is as it should be"),
    };
    vec![ValueTable::new(head, rows).block(), Block::Verdict(verdict)]
}

fn row(material: &str, profile: &MeasuredProfile) -> Vec<String> {
    let range = |values: &[f64]| {
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        format!("{least:.3}…{most:.3}")
    };
    vec![
        material.to_owned(),
        profile.channel().to_owned(),
        profile.thickness_mm().to_string(),
        profile.values().len().to_string(),
        range(profile.x_mm()),
        range(profile.values()),
        profile.std_errors().map_or_else(|| "not given".to_owned(), range),
    ]
}
