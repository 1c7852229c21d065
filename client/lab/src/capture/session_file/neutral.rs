//! Reads the grey patches of a session, whose reflectances are numbers or a table over wavelength.

use std::path::Path;

use optics_capture::{Area, Neutral};
use optics_model::Invalid;
use serde::Deserialize;

use crate::capture::bands::Band;
use crate::capture::spectrum::Spectrum;

/// Relative error of reflectances without one.
const NEUTRAL_STD_ERROR: f64 = 0.01;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NeutralTable {
    pub(super) shots: Vec<String>,
    rho: NeutralRho,
    pub(super) std_error: Option<f64>,
    areas_px: Option<Vec<[f64; 4]>>,
}

/// Reflectances of the patches, or a table of them over wavelength.
#[derive(Debug, Clone, Deserialize)]
#[serde(
    untagged,
    expecting = "must be a list with a number or three for each patch, or the name of a table (CSV)"
)]
enum NeutralRho {
    Each(Vec<Rho>),
    Table(String),
}

/// A reflectance for all channels, or one for each.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged)]
enum Rho {
    All(f64),
    Each([f64; 3]),
}

impl NeutralTable {
    /// The patches, with their reflectances in a band under the light of lamps.
    pub(super) fn read(
        &self,
        folder: &Path,
        band: Option<&Band>,
        light: Option<&Spectrum>,
    ) -> Result<Neutral, Invalid> {
        let rho = match (&self.rho, band) {
            (NeutralRho::Each(rho), _) => rho.iter().map(|rho| rho.of(band)).collect::<Result<_, _>>()?,
            (NeutralRho::Table(file), Some(band)) => {
                let patches = Spectrum::read_in(folder, "neutral.rho", file)?;
                let mean = |patch| Ok([band.mean("neutral.rho", patch, light)?; 3]);
                patches.iter().map(mean).collect::<Result<_, _>>()?
            }
            (NeutralRho::Table(file), None) => {
                let allowed = "a table over wavelength needs [[band]]; red, green and blue need numbers";
                return Err(Invalid::new("neutral.rho", format!("{file:?}"), allowed));
            }
        };
        let area = |[x, y, width, height]: &[f64; 4]| Area { x: *x, y: *y, width: *width, height: *height };
        let areas = self.areas_px.as_ref().map(|areas| areas.iter().map(area).collect());
        let std_error = self.std_error.unwrap_or(NEUTRAL_STD_ERROR);
        Neutral::new(rho, std_error, areas).map_err(|e| e.within("neutral"))
    }
}

impl Rho {
    /// Its values in the columns of a part; a band has one value.
    fn of(&self, band: Option<&Band>) -> Result<[f64; 3], Invalid> {
        match self {
            Self::All(value) => Ok([*value; 3]),
            Self::Each(values) if band.is_none() => Ok(*values),
            Self::Each(values) => {
                let allowed = "bands need one number a patch, or a table over wavelength";
                Err(Invalid::new("neutral.rho", format!("{values:?}"), allowed))
            }
        }
    }
}
