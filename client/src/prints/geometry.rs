//! The layers, lamps and sensor through which a print is seen.

use anyhow::{Result, bail};
use clap::ValueEnum;
use farm_lab::chart::bare_print;
use optics_model::Scene;
use optics_model::scene::{Layer, LayerMedium, RingLight};
use serde::Deserialize;

/// How a print is lit and seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Geometry {
    /// The set-up of the measurement: its layers, ring and sensor; the base lies under its coat.
    Session,
    /// 45°a:0° (ISO 13655): a ring of 45° ± 5°, seen from above; the bare print lies on the base, with air between.
    #[value(name = "45:0")]
    #[serde(rename = "45:0")]
    FortyFiveZero,
    /// di:8° (ISO 7724, CIE 15): light from everywhere, with the mirrored, seen at 8°; the bare print lies on the base.
    #[value(name = "d:8")]
    #[serde(rename = "d:8")]
    DiffuseEight,
}

impl Geometry {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Session => "session",
            Self::FortyFiveZero => "45:0",
            Self::DiffuseEight => "d:8",
        }
    }

    /// The scene of a print, given that of the measurement in a channel. A bare print has the roughness of the scene's
    /// sample, unless another is given.
    pub(crate) fn scene(self, session: Scene, roughness: Option<f64>) -> Result<Scene> {
        if self == Self::Session && roughness.is_some() {
            bail!("--roughness is that of a bare print: give --geometry 45:0 or d:8");
        }
        let (ring, polar_deg) = match self {
            Self::Session => return Ok(session),
            Self::FortyFiveZero => (RingLight::new(40.0, 50.0)?, 0.0),
            Self::DiffuseEight => (RingLight::new(0.0, 90.0)?, 8.0),
        };
        let is_sample = |layer: &&Layer| layer.medium() == LayerMedium::Sample;
        let of_scene = session.layers().iter().find(is_sample).map_or(0.0, Layer::roughness);
        let roughness = roughness.unwrap_or(of_scene);
        let scene = bare_print(ring, polar_deg, roughness, session.channels().to_vec())?;
        let scene = scene.with_multiple_scattering(session.multiple_scattering());
        Ok(scene.with_sample_ior_offset(session.sample_ior_offset()))
    }
}
