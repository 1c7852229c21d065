//! Formats records as rows of CSV or as JSON, many at once. Texts that rows share are formatted once.

use std::io::Write;

use anyhow::Result;
use optics_model::{Estimate, Grid, Record};
use rayon::iter::{IntoParallelRefIterator as _, ParallelIterator as _};
use serde::Serialize;

use super::variant::VariedQuantity;
use crate::output::envelope;

/// The form of the records of a grid.
#[derive(Debug)]
pub(super) struct RecordText<'a> {
    grid: &'a Grid,
    is_json: bool,
    /// Centres of the pixels in mm.
    x_mm: Vec<String>,
}

impl<'a> RecordText<'a> {
    pub(super) fn new(grid: &'a Grid, is_json: bool) -> Self {
        let sensor = grid.scene().sensor();
        let x_mm = (0..sensor.pixels()).map(|pixel| sensor.centre_mm(pixel).to_string()).collect();
        Self { grid, is_json, x_mm }
    }

    /// The texts of records, in their order.
    pub(super) fn of_all(&self, records: &[Record]) -> Result<Vec<Vec<u8>>> {
        records.par_iter().map(|record| self.of(record)).collect()
    }

    fn of(&self, record: &Record) -> Result<Vec<u8>> {
        let mut text = Vec::new();
        if self.is_json {
            writeln!(text, "{}", envelope("record", &RecordJson::new(self.grid, record))?)?;
        } else {
            self.write_rows(&mut text, record)?;
        }
        Ok(text)
    }

    fn write_rows(&self, out: &mut Vec<u8>, record: &Record) -> Result<()> {
        let (point, medium) = self.grid.parameters(record.index);
        let variant = VariedQuantity::of_record(self.grid, record.index);
        let variant = variant.map_or_else(String::new, |v| format!(",{},{},{}", v.quantity, v.step, v.unit));
        for (channel, profile) in self.grid.scene().channels().iter().zip(&record.profiles) {
            let medium = format!(
                "{}{variant},{},{},{},{},{},{}",
                record.index,
                medium.sigma_t_per_mm(),
                medium.albedo(),
                medium.g(),
                point.thickness_mm(),
                point.sample_ior(),
                channel.name(),
            );
            for (pixel, x_mm) in self.x_mm.iter().enumerate() {
                write!(out, "{medium},{x_mm}")?;
                for estimate in profile.estimates() {
                    write!(out, ",{},{}", estimate.values()[pixel], estimate.std_errors()[pixel])?;
                }
                out.push(b'\n');
            }
        }
        Ok(())
    }
}

pub(super) fn write_head(out: &mut impl Write, grid: &Grid, responses: bool) -> Result<()> {
    let variant = if responses { ",quantity,step,unit" } else { "" };
    write!(
        out,
        "record{variant},sigma_t_per_mm,albedo,g,thickness_mm,sample_ior,channel,x_mm,value,std_error"
    )?;
    if grid.derivatives() {
        write!(out, ",d_albedo,d_albedo_std_error,d_sigma_t,d_sigma_t_std_error")?;
    }
    writeln!(out)?;
    Ok(())
}

#[derive(Debug, Serialize)]
struct RecordJson<'a> {
    record: usize,
    /// The varied quantity of a record of the responses.
    #[serde(flatten)]
    variant: Option<VariedQuantity>,
    sigma_t_per_mm: f64,
    albedo: f64,
    g: f64,
    thickness_mm: f64,
    sample_ior: f64,
    channels: Vec<RecordProfileJson<'a>>,
}

#[derive(Debug, Serialize)]
struct RecordProfileJson<'a> {
    channel: &'a str,
    values: &'a [f32],
    std_errors: &'a [f32],
    #[serde(skip_serializing_if = "Option::is_none")]
    d_albedo: Option<EstimateJson<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    d_sigma_t: Option<EstimateJson<'a>>,
}

#[derive(Debug, Serialize)]
struct EstimateJson<'a> {
    values: &'a [f32],
    std_errors: &'a [f32],
}

impl<'a> From<&'a Estimate> for EstimateJson<'a> {
    fn from(e: &'a Estimate) -> Self {
        Self { values: e.values(), std_errors: e.std_errors() }
    }
}

impl<'a> RecordJson<'a> {
    fn new(grid: &'a Grid, record: &'a Record) -> Self {
        let (point, medium) = grid.parameters(record.index);
        let channels =
            grid.scene().channels().iter().zip(&record.profiles).map(|(channel, p)| RecordProfileJson {
                channel: channel.name(),
                values: p.radiance_factor.values(),
                std_errors: p.radiance_factor.std_errors(),
                d_albedo: p.derivatives.as_ref().map(|d| (&d.albedo).into()),
                d_sigma_t: p.derivatives.as_ref().map(|d| (&d.sigma_t).into()),
            });
        Self {
            record: record.index,
            variant: VariedQuantity::of_record(grid, record.index),
            sigma_t_per_mm: medium.sigma_t_per_mm(),
            albedo: medium.albedo(),
            g: medium.g(),
            thickness_mm: point.thickness_mm(),
            sample_ior: point.sample_ior(),
            channels: channels.collect(),
        }
    }
}
