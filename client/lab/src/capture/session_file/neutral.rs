//! Reads the grey patches of a session, whose reflectances are numbers or a table over wavelength.

use std::path::Path;

use optics_capture::{Area, Neutral};
use optics_model::scene::{Prior, PriorKind};
use optics_model::{Invalid, Scene};
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
    /// Shots of the white at other exposure times.
    #[serde(default)]
    pub(super) exposures: Vec<String>,
    geometry: Option<Certificate>,
}

/// The geometry of a certificate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
enum Certificate {
    /// Light from 8°, all of the reflected light: the usual certificate of sintered PTFE.
    #[serde(rename = "8:h")]
    Hemispherical,
    /// Light from 45°, seen along the normal.
    #[serde(rename = "45:0")]
    Directional,
    /// The session's own light and camera.
    #[serde(rename = "own")]
    Own,
}

/// The radiance factor of sintered PTFE under light from 45°, seen along the normal, over its reflectance 8:h, and its
/// relative change per degree towards the horizon: 1.028, 1.012 and 0.993 at 40, 45 and 50° for 0.989 (M. P. Lévesque and
/// M. Dissanska, Measurement and modeling of the Spectralon spectro-polarimetric BRDF, 2016).
const PTFE: f64 = 1.0233;
const PTFE_PER_DEG: f64 = -0.0035;
/// Relative standard error of either.
const PTFE_STD_ERROR: f64 = 0.003;
/// Angles from the normal for which the change is known.
const KNOWN_DEG: std::ops::RangeInclusive<f64> = 35.0..=55.0;
/// Reflectance above which a patch can only be such a white.
const WHITE: f64 = 0.9;
/// Relative standard error of a white's radiance factor if the geometry of its certificate is not known.
const UNKNOWN: f64 = 0.012;

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
    /// Factor from reflectances to radiance factors under the light of a scene, and its relative standard error.
    fn seen(&self, scene: &Scene, is_white: bool) -> Result<[f64; 2], Invalid> {
        let (at_45, of_45) = match self.geometry {
            Some(Certificate::Own) => return Ok([1.0, 0.0]),
            None => return Ok([1.0, if is_white { UNKNOWN } else { 0.0 }]),
            Some(Certificate::Hemispherical) => (PTFE, PTFE_STD_ERROR),
            Some(Certificate::Directional) => (1.0, 0.0),
        };
        let middle_deg = 0.5 * (scene.light().inner_deg() + scene.light().outer_deg());
        if !KNOWN_DEG.contains(&middle_deg) {
            let allowed = format!(
                "the radiance factor of a white is known for light from {} to {}°, and the scene's comes from {middle_deg}°: \
                 give that of this light, and geometry = \"own\"",
                KNOWN_DEG.start(),
                KNOWN_DEG.end()
            );
            return Err(Invalid::new("neutral.geometry", "a certificate", allowed));
        }
        let of_ring = scene.priors().iter().find(|prior| prior.kind() == PriorKind::RingAngle);
        let slope = PTFE_PER_DEG.abs() * of_ring.map_or(0.0, Prior::std_error);
        Ok([at_45 * (1.0 + PTFE_PER_DEG * (middle_deg - 45.0)), libm::hypot(of_45, slope)])
    }

    /// A doubt about patches of which one can only be a white whose certificate needs a geometry, if none is stated.
    pub(super) fn doubt(&self, patches: &Neutral) -> Option<String> {
        let is_unknown = self.geometry.is_none() && patches.brightest() > WHITE;
        is_unknown.then(|| {
            "neutral.geometry is not given: a certificate \"8:h\" of sintered PTFE is 2.3 % below what a camera sees under \
             light from 45°, one \"45:0\" is not, and a value in the session's own light is \"own\"; without it the white \
             counts as uncertain by another 1.2 %"
                .to_owned()
        })
    }

    /// The patches, with their radiance factors in a band under the light of lamps and in the geometry of the scene.
    pub(super) fn read(
        &self,
        folder: &Path,
        band: Option<&Band>,
        light: Option<&Spectrum>,
        scene: &Scene,
    ) -> Result<Neutral, Invalid> {
        let rho: Vec<Vec<f64>> = match (&self.rho, band) {
            (NeutralRho::Each(rho), _) => rho.iter().map(|rho| rho.of(band)).collect::<Result<_, _>>()?,
            (NeutralRho::Table(file), Some(band)) => {
                let patches = Spectrum::read_in(folder, "neutral.rho", file)?;
                let mean = |patch| Ok(vec![band.mean("neutral.rho", patch, light)?]);
                patches.iter().map(mean).collect::<Result<_, _>>()?
            }
            (NeutralRho::Table(file), None) => {
                let allowed = "a table over wavelength needs [[band]]; red, green and blue need numbers";
                return Err(Invalid::new("neutral.rho", format!("{file:?}"), allowed));
            }
        };
        let area = |[x, y, width, height]: &[f64; 4]| Area { x: *x, y: *y, width: *width, height: *height };
        let areas = self.areas_px.as_ref().map(|areas| areas.iter().map(area).collect());
        let is_white = rho.iter().flatten().any(|rho| *rho > WHITE);
        let [factor, of_geometry] = self.seen(scene, is_white)?;
        let std_error = libm::hypot(self.std_error.unwrap_or(NEUTRAL_STD_ERROR), of_geometry);
        let rho = rho.into_iter().map(|patch| patch.into_iter().map(|rho| rho * factor).collect()).collect();
        Neutral::new(rho, std_error, areas).map_err(|e| e.within("neutral"))
    }
}

impl Rho {
    /// Its values in the columns of a part: one for a band, otherwise those of red, green and blue.
    fn of(&self, band: Option<&Band>) -> Result<Vec<f64>, Invalid> {
        match self {
            Self::All(value) => Ok(vec![*value; if band.is_some() { 1 } else { 3 }]),
            Self::Each(values) if band.is_none() => Ok(values.to_vec()),
            Self::Each(values) => {
                let allowed = "bands need one number a patch, or a table over wavelength";
                Err(Invalid::new("neutral.rho", format!("{values:?}"), allowed))
            }
        }
    }
}
