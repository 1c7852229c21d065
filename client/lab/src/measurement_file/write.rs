//! Writes simulated profiles in the strict format, so that they can be measured like photographs.

use std::io::Write;

use anyhow::Result;
use optics_model::{Invalid, Profile, Scene};

use super::columns::{SET_UP, names};

/// The set-up of a simulation: the thickness is exact, the edge lies at 0, no camera blurs.
const EXACT: [&str; SET_UP] = ["0"; SET_UP];

/// Writes the profiles of one material.
#[derive(Debug)]
pub struct MeasurementWriter<W: Write> {
    rows: csv::Writer<W>,
    material: String,
}

impl<W: Write> MeasurementWriter<W> {
    pub fn new(out: W, material: &str) -> Result<Self> {
        let mut rows = csv::WriterBuilder::new().comment(Some(b'#')).from_writer(out);
        rows.write_record(names())?;
        Ok(Self { rows, material: check_name(material)?.to_owned() })
    }

    /// Adds all channels of a scene at one thickness, except those that only show the effect of the white reference.
    pub fn add(&mut self, scene: &Scene, thickness_mm: f64, profiles: &[Profile]) -> Result<()> {
        for index in scene.seen_channels() {
            let (channel, estimate) = (&scene.channels()[index], &profiles[index].radiance_factor);
            for (pixel, (value, error)) in estimate.values().iter().zip(estimate.std_errors()).enumerate() {
                let numbers = [thickness_mm, scene.sensor().centre_mm(pixel)].map(|v| v.to_string());
                let estimates = [value, error].map(ToString::to_string);
                let names = [self.material.as_str(), channel.name()];
                let numbers = numbers.iter().chain(&estimates).map(String::as_str);
                self.rows.write_record(names.into_iter().chain(numbers).chain(EXACT))?;
            }
        }
        Ok(())
    }

    pub fn finish(mut self) -> Result<()> {
        self.rows.flush()?;
        Ok(())
    }
}

impl MeasurementWriter<Vec<u8>> {
    /// The written CSV.
    pub fn into_bytes(self) -> Result<Vec<u8>> {
        Ok(self.rows.into_inner()?)
    }
}

/// Refuses names that would be read differently from how they were written.
pub fn check_name(material: &str) -> Result<&str, Invalid> {
    let sound = !material.is_empty() && material.trim() == material && !material.contains(char::is_control);
    let allowed = "a name must not be empty, begin or end with a space, or contain a line break";
    if sound { Ok(material) } else { Err(Invalid::new("measurement", format_args!("{material:?}"), allowed)) }
}
