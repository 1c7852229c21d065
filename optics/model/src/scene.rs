//! The virtual measurement set-up: a stack of plane layers over a black–white edge.
//!
//! Setting after Elek, Sumin et al. 2017, supplement, Secs. 4 and 5.1.

pub(crate) mod boards;
mod built_in;
mod differences;
mod dispersion;
mod priors;
mod wavelengths;

use crate::angle::sin2;
use crate::invalid::{Invalid, Result, check};
use crate::measurement::wavelength_nm;
use crate::medium::{check_ior, check_thickness};
use crate::phase::PhaseShape;
pub use differences::SceneDifference;
pub use dispersion::{D_LINE_NM, Dispersion, DispersionCurve};
pub use priors::{MAX_PRIORS, Prior, PriorKind, Scope};

/// Most layers, channels and pixels that a scene may have.
pub const MAX_LAYERS: usize = 32;
pub const MAX_CHANNELS: usize = 64;
pub const MAX_PIXELS: u32 = 8192;

/// The medium of a layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LayerMedium {
    /// Neither scatters nor absorbs.
    Clear { ior: f64, thickness_mm: f64 },
    /// The slab under test: index, thickness and scattering come from the transport point.
    Sample,
}

/// A plane layer, infinite in x and y.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    name: String,
    medium: LayerMedium,
    roughness: f64,
}

impl Layer {
    /// A clear layer; `roughness` is the GGX α of its upper face, 0 for a smooth one.
    pub fn clear(name: impl Into<String>, ior: f64, thickness_mm: f64, roughness: f64) -> Result<Self> {
        check_ior("ior", ior)?;
        if thickness_mm != 0.0 {
            check_thickness(thickness_mm).map_err(|_| {
                Invalid::new("thickness_mm", thickness_mm, "allowed are 0 and 1e-4 to 1000 mm")
            })?;
        }
        Ok(Self {
            name: name.into(),
            medium: LayerMedium::Clear { ior, thickness_mm },
            roughness: check_roughness(roughness)?,
        })
    }

    /// The slab under test.
    pub fn sample(name: impl Into<String>, roughness: f64) -> Result<Self> {
        Ok(Self { name: name.into(), medium: LayerMedium::Sample, roughness: check_roughness(roughness)? })
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn medium(&self) -> LayerMedium {
        self.medium
    }

    /// GGX α of the upper face; 0 is smooth.
    pub fn roughness(&self) -> f64 {
        self.roughness
    }
}

fn check_roughness(value: f64) -> Result<f64> {
    check(
        "roughness",
        value,
        |v| v == 0.0 || (1e-3..=1.0).contains(&v),
        "allowed are 0 (smooth) and 0.001 to 1",
    )
}

/// Where ρ of the base was measured with a white reference, an error of the reference changes both the measured values
/// and ρ. A scene models this by a second channel whose ρ was determined with a reference of this share of the
/// reflectance.
pub const DARKER_WHITE: f64 = 0.99;

/// End of the name of such a channel.
const UNDER_DARKER_WHITE: &str = " (white -1 %)";

/// Least ρ of the dark side. A board that mirrors less of the lamps than the scene's coat does appears darker than a
/// black base would under that coat, and ρ < 0 describes it: the radiance factor s + a ρ/(1 − b ρ) stays positive.
pub const LEAST_RHO_DARK: f64 = -0.1;

/// One colour channel: reflectances of the Lambertian base for x ≥ 0 (light, 0 to 1) and x < 0 (dark,
/// [`LEAST_RHO_DARK`] to 1).
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    name: String,
    rho_light: f64,
    rho_dark: f64,
}

impl Channel {
    pub fn new(name: impl Into<String>, rho_light: f64, rho_dark: f64) -> Result<Self> {
        let name = name.into();
        if name.is_empty() || name.len() > 32 || name.contains([',', '"', '\n', '\r']) {
            return Err(Invalid::new(
                "name",
                format_args!("{name:?}"),
                "1 to 32 bytes, no comma, quote or line end",
            ));
        }
        let within = |least: f64| move |rho: f64| (least..=1.0).contains(&rho);
        Ok(Self {
            name,
            rho_light: check("rho_light", rho_light, within(0.0), "allowed are 0 to 1")?,
            rho_dark: check("rho_dark", rho_dark, within(LEAST_RHO_DARK), "allowed are -0.1 to 1")?,
        })
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn rho_light(&self) -> f64 {
        self.rho_light
    }

    pub fn rho_dark(&self) -> f64 {
        self.rho_dark
    }

    /// Name of the channel with the base's ρ under a white reference that is darker by 1 %: [`DARKER_WHITE`].
    pub fn darker_white(name: &str) -> String {
        format!("{name}{UNDER_DARKER_WHITE}")
    }

    /// The wavelength in nm that the name is.
    pub fn wavelength_nm(&self) -> Option<f64> {
        wavelength_nm(self.name.strip_suffix(UNDER_DARKER_WHITE).unwrap_or(&self.name))
    }
}

/// A light that is uniform between two polar angles in air and black elsewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RingLight {
    inner_deg: f64,
    outer_deg: f64,
}

impl RingLight {
    pub fn new(inner_deg: f64, outer_deg: f64) -> Result<Self> {
        check(
            "inner_deg",
            inner_deg,
            |v| (0.0..90.0).contains(&v),
            "allowed are 0 to 90 degrees, below outer_deg",
        )?;
        check(
            "outer_deg",
            outer_deg,
            |v| v - inner_deg >= 0.01 && v <= 90.0,
            "allowed are angles at least 0.01 degrees above inner_deg, at most 90 degrees",
        )?;
        Ok(Self { inner_deg, outer_deg })
    }

    pub fn inner_deg(&self) -> f64 {
        self.inner_deg
    }

    pub fn outer_deg(&self) -> f64 {
        self.outer_deg
    }

    /// sin²θ_outer − sin²θ_inner: irradiance of the ring over π times its radiance.
    pub fn measure(&self) -> f64 {
        sin2(self.outer_deg) - sin2(self.inner_deg)
    }
}

/// An orthographic row of box-filtered pixels across the edge, centred on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    width_mm: f64,
    pixels: u32,
    polar_deg: f64,
}

impl Sensor {
    /// `polar_deg` tilts the viewing direction from the normal, along the edge.
    pub fn new(width_mm: f64, pixels: u32, polar_deg: f64) -> Result<Self> {
        check("width_mm", width_mm, |v| (1e-3..=1e4).contains(&v), "allowed are 0.001 to 10000 mm")?;
        if !(1..=MAX_PIXELS).contains(&pixels) {
            return Err(Invalid::new("pixels", pixels, format!("allowed are 1 to {MAX_PIXELS}")));
        }
        check("polar_deg", polar_deg, |v| (0.0..=89.0).contains(&v), "allowed are 0 to 89 degrees")?;
        Ok(Self { width_mm, pixels, polar_deg })
    }

    pub fn width_mm(&self) -> f64 {
        self.width_mm
    }

    pub fn pixels(&self) -> usize {
        self.pixels as usize
    }

    pub fn polar_deg(&self) -> f64 {
        self.polar_deg
    }

    pub fn pitch_mm(&self) -> f64 {
        self.width_mm / f64::from(self.pixels)
    }

    /// Centre of pixel `i` in mm, the edge being at 0.
    pub fn centre_mm(&self, i: usize) -> f64 {
        (i as f64 + 0.5) * self.pitch_mm() - 0.5 * self.width_mm
    }
}

/// Everything that a profile depends on besides the transport point and the albedo.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    layers: Vec<Layer>,
    channels: Vec<Channel>,
    light: RingLight,
    sensor: Sensor,
    multiple_scattering: bool,
    sample_ior_offset: f64,
    phase: PhaseShape,
    base_spread_mm: f64,
    priors: Vec<Prior>,
}

impl Scene {
    /// Layers go from top to bottom, with air above the first and the base under the last.
    /// `multiple_scattering` follows paths on rough interfaces until they leave.
    pub fn new(
        layers: Vec<Layer>,
        channels: Vec<Channel>,
        light: RingLight,
        sensor: Sensor,
        multiple_scattering: bool,
    ) -> Result<Self> {
        if layers.len() > MAX_LAYERS {
            return Err(Invalid::new("layers", layers.len(), format!("at most {MAX_LAYERS} are allowed")));
        }
        let samples = layers.iter().filter(|l| l.medium == LayerMedium::Sample).count();
        if samples != 1 {
            return Err(Invalid::new(
                "layers",
                format_args!("{samples} sample layers"),
                "exactly one layer must be the sample",
            ));
        }
        check_channels(&channels)?;
        Ok(Self {
            layers,
            channels,
            light,
            sensor,
            multiple_scattering,
            sample_ior_offset: 0.0,
            phase: PhaseShape::default(),
            base_spread_mm: 0.0,
            priors: Vec::new(),
        })
    }

    /// Index of the channel that models an error of the white reference of this one.
    pub fn under_darker_white(&self, channel: usize) -> Option<usize> {
        let name = Channel::darker_white(self.channels[channel].name());
        self.channels.iter().position(|c| c.name == name)
    }

    /// Indices of the channels of a camera: all but those under a darker white reference.
    pub fn seen_channels(&self) -> impl Iterator<Item = usize> {
        let darker: Vec<_> = (0..self.channels.len()).filter_map(|i| self.under_darker_white(i)).collect();
        (0..self.channels.len()).filter(move |i| !darker.contains(i))
    }

    pub fn with_channels(self, channels: Vec<Channel>) -> Result<Self> {
        check_channels(&channels)?;
        Ok(Self { channels, ..self })
    }

    #[must_use]
    pub fn with_sensor(self, sensor: Sensor) -> Self {
        Self { sensor, ..self }
    }

    #[must_use]
    pub fn with_light(self, light: RingLight) -> Self {
        Self { light, ..self }
    }

    #[must_use]
    pub fn with_multiple_scattering(self, multiple_scattering: bool) -> Self {
        Self { multiple_scattering, ..self }
    }

    /// The scene with an offset of the sample's index from the grid's.
    #[must_use]
    pub fn with_sample_ior_offset(self, sample_ior_offset: f64) -> Self {
        Self { sample_ior_offset, ..self }
    }

    /// The scene with another shape of the sample's phase function.
    #[must_use]
    pub fn with_phase(self, phase: PhaseShape) -> Self {
        Self { phase, ..self }
    }

    /// The scene with another spread of light within the base ([`Self::base_spread_mm`]), 0 to 10 mm.
    pub fn with_base_spread(self, base_spread_mm: f64) -> Result<Self> {
        let allowed = "allowed are 0 to 10 mm";
        let base_spread_mm = check("base_spread_mm", base_spread_mm, |v| (0.0..=10.0).contains(&v), allowed)?;
        Ok(Self { base_spread_mm, ..self })
    }

    /// The mean distance across the edge, to either side, between the places at which light enters the base and leaves it.
    /// It has an exponential distribution, and light crosses the ink at both places: each has the factor √ρ.
    pub fn base_spread_mm(&self) -> f64 {
        self.base_spread_mm
    }

    /// The shape of the sample's phase function; its mean cosine is that of the transport point.
    pub fn phase(&self) -> &PhaseShape {
        &self.phase
    }

    /// Offset of the sample's refractive index from that of the transport point.
    pub fn sample_ior_offset(&self) -> f64 {
        self.sample_ior_offset
    }

    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    pub fn light(&self) -> RingLight {
        self.light
    }

    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    pub fn multiple_scattering(&self) -> bool {
        self.multiple_scattering
    }
}

fn check_channels(channels: &[Channel]) -> Result<()> {
    if !(1..=MAX_CHANNELS).contains(&channels.len()) {
        return Err(Invalid::new("channels", channels.len(), format!("1 to {MAX_CHANNELS} are allowed")));
    }
    for (i, channel) in channels.iter().enumerate() {
        if channels[..i].iter().any(|c| c.name == channel.name) {
            return Err(Invalid::new(format!("channels[{i}].name"), &channel.name, "names must differ"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dark_side_alone_may_be_below_black() {
        assert_eq!(Channel::new("R", 0.9, -0.1).unwrap().rho_dark(), -0.1);
        let message = |light, dark| Channel::new("R", light, dark).unwrap_err().to_string();
        assert_eq!(message(0.9, -0.11), "rho_dark = -0.11 is not valid: allowed are -0.1 to 1");
        assert_eq!(message(-0.01, 0.0), "rho_light = -0.01 is not valid: allowed are 0 to 1");
    }
}
