//! Describes the arrays of a dictionary (names, units, axes), and reads the records that fill them.

use std::collections::BTreeMap;

use anyhow::{Result, bail, ensure};
use farm_proto::status::DictionaryStatus;
use optics_model::{Estimate, Grid, Profile, Record};
use serde::Serialize;

use super::chosen::ChosenAxes;
use super::variant::VariedQuantity;
use crate::commands::dictionaries::show;
use crate::connection::Connection;
use crate::connection::records::RecordStream;
use crate::output::grouped;

/// Axes of the arrays of records, the last one running fastest; only arrays of responses have the first.
const AXES: [&str; 8] =
    ["variant", "sample_ior", "sigma_t_per_mm", "g", "thickness_mm", "albedo", "channel", "x_mm"];

/// The axes of the chosen records.
pub(super) fn axes(chosen: &ChosenAxes) -> &'static [&'static str] {
    if chosen.variants().is_empty() { &AXES[1..] } else { &AXES }
}

/// An array of records: its name and unit, and the index of a profile's estimate that fills it.
pub(super) struct Array {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    estimate: usize,
    errors: bool,
}

impl Array {
    /// The arrays of a grid's records.
    pub(super) fn all(grid: &Grid) -> &'static [Self] {
        if grid.derivatives() { &ARRAYS } else { &ARRAYS[..2] }
    }

    /// Its numbers for a profile, one for each pixel.
    ///
    /// # Panics
    /// If the profile lacks derivatives that the grid requires.
    pub(super) fn numbers<'p>(&self, profile: &'p Profile) -> &'p [f32] {
        let estimate: &Estimate = profile.estimates().nth(self.estimate).expect("records are checked");
        if self.errors { estimate.std_errors() } else { estimate.values() }
    }

    const fn of(name: &'static str, unit: &'static str, estimate: usize, errors: bool) -> Self {
        Self { name, unit, estimate, errors }
    }
}

const PER_ALBEDO: &str = "radiance factor per albedo";
const PER_SIGMA_T: &str = "radiance factor mm";

/// All arrays in the order of a profile's estimates; all but the first two require derivatives.
const ARRAYS: [Array; 6] = [
    Array::of("value", "radiance factor", 0, false),
    Array::of("std_error", "radiance factor", 0, true),
    Array::of("d_albedo", PER_ALBEDO, 1, false),
    Array::of("d_albedo_std_error", PER_ALBEDO, 1, true),
    Array::of("d_sigma_t", PER_SIGMA_T, 2, false),
    Array::of("d_sigma_t_std_error", PER_SIGMA_T, 2, true),
];

/// Names of the channels.
pub(super) fn channels(grid: &Grid) -> Vec<&str> {
    grid.scene().channels().iter().map(optics_model::scene::Channel::name).collect()
}

/// Centres of the pixels.
pub(super) fn x_mm(grid: &Grid) -> Vec<f64> {
    let sensor = grid.scene().sensor();
    (0..sensor.pixels()).map(|i| sensor.centre_mm(i)).collect()
}

/// The values along each axis except that of the channels.
pub(super) fn numeric_axes(
    grid: &Grid,
    chosen: &ChosenAxes,
) -> impl Iterator<Item = (&'static str, Vec<f64>)> {
    let [iors, sigmas, gs, thicknesses, albedos] = chosen.values(grid);
    let values = [iors, sigmas, gs, thicknesses, albedos, x_mm(grid)];
    AXES[1..].iter().copied().filter(|name| *name != "channel").zip(values)
}

/// The variants along the first axis of responses; empty for records of the axes.
pub(super) fn variants(grid: &Grid, chosen: &ChosenAxes) -> Vec<VariedQuantity> {
    chosen.variants().iter().filter_map(|variant| VariedQuantity::of(grid, *variant)).collect()
}

/// The unit of an axis, if it has one.
pub(super) fn unit_of_axis(name: &str) -> Option<&'static str> {
    match name {
        "sigma_t_per_mm" => Some("1/mm"),
        "thickness_mm" | "x_mm" => Some("mm"),
        _ => None,
    }
}

/// The answer of `show --json`, and the meaning of the arrays.
pub(super) fn about(
    status: &DictionaryStatus,
    chosen: &ChosenAxes,
    arrays: &'static [Array],
) -> Result<serde_json::Value> {
    #[derive(Serialize)]
    struct ArraysAbout<D> {
        farmctl: &'static str,
        axes: &'static [&'static str],
        units: BTreeMap<&'static str, &'static str>,
        #[serde(skip_serializing_if = "Vec::is_empty")]
        variants: Vec<VariedQuantity>,
        dictionary: D,
    }
    let of_axes = AXES.into_iter().filter_map(|axis| Some((axis, unit_of_axis(axis)?)));
    let units = arrays.iter().map(|array| (array.name, array.unit)).chain(of_axes).collect();
    let about = ArraysAbout {
        farmctl: env!("CARGO_PKG_VERSION"),
        axes: axes(chosen),
        units,
        variants: variants(&status.grid, chosen),
        dictionary: show::data(status),
    };
    Ok(serde_json::to_value(&about)?)
}

/// The chosen records, all of which must be done: arrays cannot represent missing records.
pub(super) struct Complete<'a> {
    records: RecordStream<'a>,
    dictionary: &'a DictionaryStatus,
    wanted: std::vec::IntoIter<u32>,
}

impl<'a> Complete<'a> {
    pub(super) async fn ask(
        connection: &'a Connection,
        dictionary: &'a DictionaryStatus,
        chosen: &ChosenAxes,
    ) -> Result<Self> {
        let wanted = chosen.records(&dictionary.grid);
        let total = dictionary.grid.record_count();
        let is_all = chosen.variants().is_empty() && wanted.len() == total;
        let indices = if is_all { Vec::new() } else { wanted.clone() };
        let records = RecordStream::ask(connection, dictionary, indices).await?;
        let done = records.promised();
        if is_all && done < total {
            bail!(
                "{} of {} records are done: arrays have no place for what is missing; wait, choose others with \
                 --sigma-t, --albedo, --g, --thickness, or write CSV",
                grouped(done as u64),
                grouped(total as u64)
            );
        }
        Ok(Self { records, dictionary, wanted: wanted.into_iter() })
    }

    /// The next record, the albedo running fastest; `None` after the last.
    pub(super) async fn next(&mut self) -> Result<Option<Record>> {
        let Some(wanted) = self.wanted.next() else { return Ok(None) };
        let record = self.records.next().await?.filter(|record| record.index == wanted as usize);
        let Some(record) = record else {
            bail!(
                "record {wanted} is not done yet: arrays have no place for what is missing; wait, choose others with \
                 --sigma-t, --albedo, --g, --thickness, or write CSV"
            );
        };
        let shape = optics_model::profile::RecordShape::of(&self.dictionary.grid);
        ensure!(shape.check(&record).is_ok(), "record {wanted} is not one of this grid");
        Ok(Some(record))
    }
}
