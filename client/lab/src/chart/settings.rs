//! Settings of a chart, as its TOML file has them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use optics_model::Scene;
use optics_model::scene::{Channel, Layer, RingLight, Sensor};
use serde::Deserialize;

use crate::grid_file::from_toml;

/// Most that a standard error may be of its value.
const GREATEST_SHARE: f64 = 0.5;

/// How patches are lit and seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
pub enum PatchGeometry {
    /// A ring of 45° ± 5°, seen from above (ISO 13655).
    #[default]
    #[serde(rename = "45:0")]
    FortyFiveZero,
    /// Light from everywhere, with the mirrored, seen at 8°; by reciprocity also 8:d, specular included.
    #[serde(rename = "d:8", alias = "8:d")]
    DiffuseEight,
    /// All light that passes, of light from 0°; by reciprocity also the light at 0° of diffuse light.
    #[serde(rename = "transmission")]
    Transmission,
}

/// Settings of a chart.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ChartSettings {
    /// The table, next to the settings.
    pub values: PathBuf,
    /// The geometry of patches whose rows do not say it.
    pub geometry: PatchGeometry,
    /// Reflectance of the base under the lowest slab; estimated where it is missing.
    pub base: BTreeMap<String, f64>,
    pub sample_ior: f64,
    pub sample_ior_std_error: f64,
    /// Anisotropy of all materials, and the standard error of ln(1 − g).
    pub g: f64,
    pub g_std_error: f64,
    /// Standard error of all thicknesses together, as a share.
    pub thickness_std_error: f64,
    /// `free`, `none`, or a media file whose matrix is taken.
    pub matrix: String,
    /// Whether the light of each photograph is estimated where patches have places.
    pub light: bool,
    /// Media of these materials that were measured before, as over edges: the prior.
    pub media: Option<PathBuf>,
    /// Colours have the matrix of this folder's media; set by the program.
    #[serde(skip)]
    pub folder: PathBuf,
}

impl Default for ChartSettings {
    fn default() -> Self {
        Self {
            values: PathBuf::new(),
            geometry: PatchGeometry::default(),
            base: BTreeMap::new(),
            sample_ior: 1.5,
            sample_ior_std_error: 0.03,
            g: 0.4,
            g_std_error: 0.5,
            thickness_std_error: 0.03,
            matrix: "free".to_owned(),
            light: true,
            media: None,
            folder: PathBuf::new(),
        }
    }
}

impl ChartSettings {
    /// Settings of a TOML file, whose paths are relative to it.
    pub(super) fn parsed(text: &str, path: &Path) -> Result<Self> {
        let mut settings: Self = from_toml(text, path, "chart file")?;
        settings.check().with_context(|| format!("chart file {}", path.display()))?;
        path.parent().unwrap_or(Path::new("")).clone_into(&mut settings.folder);
        Ok(settings)
    }

    fn check(&self) -> Result<()> {
        optics_model::medium::check_ior("sample_ior", self.sample_ior)?;
        for (name, value, most) in [
            ("sample_ior_std_error", self.sample_ior_std_error, 0.2),
            ("g_std_error", self.g_std_error, 3.0),
            ("thickness_std_error", self.thickness_std_error, GREATEST_SHARE),
        ] {
            if !(0.0..=most).contains(&value) {
                bail!("{name} = {value} is not valid: allowed are 0 to {most}");
            }
        }
        if !(-0.9..=0.9).contains(&self.g) {
            bail!("g = {} is not valid: allowed are -0.9 to 0.9", self.g);
        }
        if let Some((channel, rho)) = self.base.iter().find(|(_, rho)| !(0.0..=0.99).contains(*rho)) {
            bail!("base.{channel} = {rho} is not valid: allowed are 0 to 0.99");
        }
        if self.values.as_os_str().is_empty() {
            bail!("values is missing: the name of the table with the patches");
        }
        Ok(())
    }

    /// A path of the settings.
    pub(super) fn place(&self, path: &Path) -> PathBuf {
        self.folder.join(path)
    }
}

impl PatchGeometry {
    pub(super) const ALL: [(&'static str, Self); 5] = [
        ("45:0", Self::FortyFiveZero),
        ("0:45", Self::FortyFiveZero),
        ("d:8", Self::DiffuseEight),
        ("8:d", Self::DiffuseEight),
        ("transmission", Self::Transmission),
    ];

    /// The bare print with air below it, without channels.
    pub(super) fn scene(self) -> Result<Scene> {
        let (ring, polar_deg) = match self {
            Self::FortyFiveZero => (RingLight::new(40.0, 50.0)?, 0.0),
            Self::DiffuseEight => (RingLight::new(0.0, 90.0)?, 8.0),
            Self::Transmission => (RingLight::new(0.0, 90.0)?, 0.0),
        };
        bare_print(ring, polar_deg, 0.0, vec![Channel::new("R", 0.5, 0.03)?])
    }
}

/// The scene of a print in air, on a base that it does not touch.
///
/// # Errors
/// If the roughness or the angle cannot be.
pub fn bare_print(ring: RingLight, polar_deg: f64, roughness: f64, channels: Vec<Channel>) -> Result<Scene> {
    let layers = vec![Layer::sample("print", roughness)?, Layer::clear("air", 1.0, 0.0, roughness)?];
    Ok(Scene::new(layers, channels, ring, Sensor::new(10.0, 1, polar_deg)?, true)?)
}
