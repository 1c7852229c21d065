//! Quantities of a scene that are known with a standard error, and the scenes in which one of them has another value.
//!
//! A fit estimates them together with the medium. Each belongs to a session, to a slab or to a material.

mod steps;

use serde::Serialize;

use super::{Channel, Dispersion, Layer, LayerMedium, RingLight, Scene, Sensor};
use crate::invalid::{Invalid, Result};
use crate::phase::{PhaseShape, SecondLobe};

/// Most uncertain quantities of a scene.
pub const MAX_PRIORS: usize = 32;

/// The kind of number of an uncertain quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PriorKind {
    /// GGX α of the upper faces of layers.
    Roughness,
    /// Refractive index of layers; that of the sample is the grid's.
    Index,
    /// Thickness of clear layers in mm.
    Thickness,
    /// Mean polar angle of the ring in degrees: both of its angles move by the same amount.
    RingAngle,
    /// Polar angle of the viewing direction in degrees.
    SensorAngle,
    /// Weight b of the second lobe of the sample's phase function, whose mean cosine stays the same.
    SecondLobeWeight,
    /// Anisotropy g₂ of the second lobe.
    SecondLobeG,
    /// Spread of light within the base in mm ([`Scene::base_spread_mm`]).
    BaseSpread,
    /// Factor on ρ of the light side in all channels.
    LightSide,
    /// Added to ρ of the dark side in all channels.
    DarkSide,
    /// Light that slip, gel and camera add to photographs of all slabs alike, as a radiance factor.
    Haze,
}

impl PriorKind {
    pub const ALL: [Self; 11] = [
        Self::Roughness,
        Self::Index,
        Self::Thickness,
        Self::RingAngle,
        Self::SensorAngle,
        Self::SecondLobeWeight,
        Self::SecondLobeG,
        Self::BaseSpread,
        Self::LightSide,
        Self::DarkSide,
        Self::Haze,
    ];

    /// Quantities that a session may measure ([`Self::session_key`]).
    pub const OF_SESSION: [Self; 4] = [Self::BaseSpread, Self::LightSide, Self::DarkSide, Self::Haze];

    /// Numbers of layers, not of light, sensor or base, in the order of their priors in a scene file.
    pub(crate) const OF_LAYERS: [Self; 5] =
        [Self::Roughness, Self::Thickness, Self::Index, Self::SecondLobeWeight, Self::SecondLobeG];

    /// Name, unit, and key in a scene file.
    const fn row(self) -> [&'static str; 3] {
        match self {
            Self::Roughness => ["roughness", "", "roughness"],
            Self::Index => ["index", "", "ior"],
            Self::Thickness => ["thickness", "mm", "thickness_mm"],
            Self::RingAngle => ["ring angle", "°", "light.std_error_deg"],
            Self::SensorAngle => ["sensor angle", "°", "sensor.std_error_deg"],
            Self::SecondLobeWeight => ["second lobe weight", "", "second_lobe_weight"],
            Self::SecondLobeG => ["second lobe g", "", "second_lobe_g"],
            Self::BaseSpread => ["base spread", "mm", "base.spread_std_error_mm"],
            Self::LightSide => ["light ρ factor", "", "base.rho_light_std_error"],
            Self::DarkSide => ["dark ρ offset", "", "base.rho_dark_std_error"],
            Self::Haze => ["haze", "", "sensor.haze_std_error"],
        }
    }

    /// Name in names of quantities and in messages.
    pub fn name(self) -> &'static str {
        self.row()[0]
    }

    /// Unit of its values, for display; empty for pure numbers.
    pub fn unit(self) -> &'static str {
        self.row()[1]
    }

    /// Key of its number in the table of a layer, or of its standard error, in a scene file.
    pub(crate) fn key(self) -> &'static str {
        self.row()[2]
    }

    /// Whether a walk takes another course when the quantity has another value. Quantities that only shift walks or
    /// change their light leave the course unchanged, and differences have little noise.
    pub fn redraws_walks(self) -> bool {
        matches!(self, Self::Roughness | Self::Index) || self.is_of_phase()
    }

    /// Key of the measured value of one of [`Self::OF_SESSION`] in a session file, and the allowed range.
    pub fn session_key(self) -> (&'static str, [f64; 2]) {
        match self {
            Self::BaseSpread => ("base_spread_mm", [0.0, 10.0]),
            Self::LightSide => ("light_side", [0.5, 1.5]),
            Self::DarkSide => ("dark_side", [-0.1, 0.1]),
            _ => ("haze", [-0.1, 0.5]),
        }
    }

    /// Whether its response is traced; haze adds itself to every pixel.
    pub fn is_traced(self) -> bool {
        self != Self::Haze
    }

    /// Whether it is a number of the base.
    pub fn is_of_base(self) -> bool {
        matches!(self, Self::BaseSpread | Self::LightSide | Self::DarkSide)
    }

    /// Whether it is a number of the sample's phase function.
    pub fn is_of_phase(self) -> bool {
        matches!(self, Self::SecondLobeWeight | Self::SecondLobeG)
    }
}

/// The scope within which a quantity has one value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// All photographs with one set-up.
    Session,
    /// One slab: each is mounted separately.
    Slab,
    /// All slabs of a material: they are cut and polished in the same way.
    Material,
    /// All slabs of a material in one channel.
    Channel,
}

impl Scope {
    pub const ALL: [Self; 4] = [Self::Session, Self::Slab, Self::Material, Self::Channel];

    pub fn name(self) -> &'static str {
        match self {
            Self::Session => "session",
            Self::Slab => "slab",
            Self::Material => "material",
            Self::Channel => "channel",
        }
    }
}

/// The prior of a number of a scene: normal, about the scene's value.
#[derive(Debug, Clone, PartialEq)]
pub struct Prior {
    kind: PriorKind,
    layers: Vec<usize>,
    std_error: f64,
    scope: Scope,
    dispersion: Option<Dispersion>,
}

impl Prior {
    /// `layers` are the indices of the layers that the number belongs to; none for angles and the base.
    /// [`Scene::with_priors`] checks that they exist and agree.
    pub fn new(kind: PriorKind, layers: Vec<usize>, std_error: f64, scope: Scope) -> Result<Self> {
        if std_error.is_finite() && std_error > 0.0 {
            Ok(Self { kind, layers, std_error, scope, dispersion: None })
        } else {
            Err(Invalid::new(
                "std_error",
                std_error,
                "allowed are numbers above 0; an exact quantity has none",
            ))
        }
    }

    /// The prior of an index that depends on the wavelength: its value is that at the D line.
    pub fn with_dispersion(self, dispersion: Dispersion) -> Result<Self> {
        if self.kind != PriorKind::Index {
            let allowed = "an index alone depends on the wavelength";
            return Err(Invalid::new("dispersion", self.kind.name(), allowed));
        }
        Ok(Self { dispersion: Some(dispersion), ..self })
    }

    pub fn dispersion(&self) -> Option<&Dispersion> {
        self.dispersion.as_ref()
    }

    pub fn kind(&self) -> PriorKind {
        self.kind
    }

    pub fn layers(&self) -> &[usize] {
        &self.layers
    }

    pub fn std_error(&self) -> f64 {
        self.std_error
    }

    pub fn scope(&self) -> Scope {
        self.scope
    }

    /// Whether it is the refractive index of the sample, which belongs to the grid, not to the scene.
    pub fn is_sample_index(&self, scene: &Scene) -> bool {
        self.kind == PriorKind::Index && self.layers.iter().all(|i| *i == scene.sample_layer())
    }
}

impl Scene {
    /// This scene with these quantities uncertain.
    pub fn with_priors(self, priors: Vec<Prior>) -> Result<Self> {
        if priors.len() > MAX_PRIORS {
            return Err(Invalid::new("priors", priors.len(), format!("at most {MAX_PRIORS} are allowed")));
        }
        for (i, prior) in priors.iter().enumerate() {
            let at = |e: Invalid| e.within(format_args!("priors[{i}]"));
            self.check_prior(prior).map_err(at)?;
            let same = |other: &&Prior| {
                other.kind == prior.kind
                    && (prior.layers.is_empty() || other.layers.iter().any(|l| prior.layers.contains(l)))
            };
            if priors[..i].iter().any(|other| same(&other)) {
                return Err(at(Invalid::new("kind", prior.kind.name(), "a quantity may have one prior")));
            }
        }
        if !priors.is_empty() && priors.iter().all(|prior| !prior.kind.is_traced()) {
            let allowed = "haze needs another quantity with a standard error";
            return Err(Invalid::new("priors", "haze alone", allowed));
        }
        Ok(Self { priors, ..self })
    }

    /// Quantities that are not known exactly.
    pub fn priors(&self) -> &[Prior] {
        &self.priors
    }

    /// Index of the layer under test.
    pub fn sample_layer(&self) -> usize {
        self.layers.iter().position(|l| l.medium() == LayerMedium::Sample).expect("a scene has a sample")
    }

    /// Name for display, such as `gel thickness` or `ring angle`.
    pub fn name_of(&self, prior: &Prior) -> String {
        match prior.layers.iter().min_by_key(|i| i.abs_diff(self.sample_layer())) {
            Some(layer) => format!("{} {}", self.layers[*layer].name(), prior.kind.name()),
            None => prior.kind.name().to_owned(),
        }
    }

    /// The scene's value of a quantity; None for the index of the sample, which is the grid's.
    pub fn value_of(&self, prior: &Prior) -> Option<f64> {
        self.number(prior.kind, prior.layers.first().copied())
    }

    /// A number of light, sensor or base, or of a layer; None if it belongs to the grid.
    pub(crate) fn number(&self, kind: PriorKind, layer: Option<usize>) -> Option<f64> {
        let layer = layer.and_then(|i| self.layers.get(i));
        match (kind, layer.map(Layer::medium)) {
            (PriorKind::RingAngle, _) => Some(0.5 * (self.light.inner_deg() + self.light.outer_deg())),
            (PriorKind::SensorAngle, _) => Some(self.sensor.polar_deg()),
            (PriorKind::BaseSpread, _) => Some(self.base_spread_mm),
            (PriorKind::LightSide, _) => Some(1.0),
            (PriorKind::DarkSide | PriorKind::Haze, _) => Some(0.0),
            (PriorKind::SecondLobeWeight, Some(LayerMedium::Sample)) => {
                self.phase.second_lobe().map(SecondLobe::weight)
            }
            (PriorKind::SecondLobeG, Some(LayerMedium::Sample)) => {
                self.phase.second_lobe().map(SecondLobe::g)
            }
            (PriorKind::Roughness, _) => layer.map(Layer::roughness),
            (PriorKind::Index, Some(LayerMedium::Clear { ior, .. })) => Some(ior),
            (PriorKind::Thickness, Some(LayerMedium::Clear { thickness_mm, .. })) => Some(thickness_mm),
            _ => None,
        }
    }

    fn check_prior(&self, prior: &Prior) -> Result<()> {
        if PriorKind::OF_LAYERS.contains(&prior.kind) == prior.layers.is_empty() {
            let given = format!("{} layers for a {}", prior.layers.len(), prior.kind.name());
            return Err(Invalid::new(
                "layers",
                given,
                "angles and the base have none, other quantities at least one",
            ));
        }
        if let Some(layer) = prior.layers.iter().find(|l| **l >= self.layers.len()) {
            return Err(Invalid::new("layers", layer, format!("the scene has {} layers", self.layers.len())));
        }
        let sample = prior.layers.contains(&self.sample_layer());
        if sample && prior.kind == PriorKind::Thickness {
            let allowed = "that of the sample is thickness_std_error_mm of a measurement";
            return Err(Invalid::new("layers", "the thickness of the sample", allowed));
        }
        if prior.kind.is_of_phase() && prior.layers != [self.sample_layer()] {
            return Err(Invalid::new(
                "layers",
                format!("{:?}", prior.layers),
                "the sample alone has a phase function",
            ));
        }
        if prior.kind.is_of_phase() && self.phase.second_lobe().is_none() {
            let allowed = "a tabulated phase function has no second lobe";
            return Err(Invalid::new("kind", prior.kind.name(), allowed));
        }
        if prior.kind == PriorKind::SecondLobeG && self.phase.second_lobe().is_some_and(|s| s.weight() == 0.0)
        {
            let allowed = "a second lobe without weight has no effect: give it a weight";
            return Err(Invalid::new("kind", prior.kind.name(), allowed));
        }
        let values: Vec<_> = prior.layers.iter().map(|l| self.number(prior.kind, Some(*l))).collect();
        if values.iter().any(|v| *v != values[0]) {
            let names: Vec<&str> = prior.layers.iter().map(|l| self.layers[*l].name()).collect();
            let allowed = format!("layers that share a {} must have the same value", prior.kind.name());
            return Err(Invalid::new("layers", names.join(", "), allowed));
        }
        if prior.kind == PriorKind::Roughness && values[0] == Some(0.0) {
            let given = format!("{} for {}", prior.std_error, self.name_of(prior));
            let allowed = "a face of roughness 0 is exactly smooth: give it a roughness, such as 0.01";
            return Err(Invalid::new("std_error", given, allowed));
        }
        for step in prior.steps(self) {
            self.varied(prior, step, self.channels.clone()).map_err(|e| {
                let (name, at) = (self.name_of(prior), e.field());
                let allowed = format!(
                    "the response of the {name} would be traced at {at} = {}: {}",
                    e.given(),
                    e.allowed()
                );
                Invalid::new("std_error", prior.std_error, allowed)
            })?;
        }
        Ok(())
    }

    /// The scene with a quantity larger by `step` and with these `channels` of the base, to whose ρ a step of a side is
    /// applied; it has no uncertain quantities.
    pub fn varied(&self, prior: &Prior, step: f64, channels: Vec<Channel>) -> Result<Self> {
        let mut scene = Self { priors: Vec::new(), ..self.clone() };
        let mut channels = channels;
        match prior.kind {
            PriorKind::Haze => {}
            PriorKind::BaseSpread => scene = scene.with_base_spread(self.base_spread_mm + step)?,
            PriorKind::LightSide | PriorKind::DarkSide => {
                let [by, added] =
                    if prior.kind == PriorKind::LightSide { [1.0 + step, 0.0] } else { [1.0, step] };
                let channel = |c: &Channel| Channel::new(c.name(), by * c.rho_light(), c.rho_dark() + added);
                channels = channels.iter().map(channel).collect::<Result<_>>()?;
            }
            PriorKind::RingAngle => {
                scene.light = RingLight::new(self.light.inner_deg() + step, self.light.outer_deg() + step)?;
            }
            PriorKind::SensorAngle => {
                let (width, pixels) = (self.sensor.width_mm(), self.sensor.pixels() as u32);
                scene.sensor = Sensor::new(width, pixels, self.sensor.polar_deg() + step)?;
            }
            PriorKind::SecondLobeWeight | PriorKind::SecondLobeG => {
                let second = self.phase.second_lobe().unwrap_or_default();
                let by = |own| if prior.kind == own { step } else { 0.0 };
                let weight = second.weight() + by(PriorKind::SecondLobeWeight);
                let second = SecondLobe::new(weight, second.g() + by(PriorKind::SecondLobeG))?;
                scene.phase = PhaseShape::Lobes(second);
            }
            kind => {
                for layer in &prior.layers {
                    scene.layers[*layer] = varied_layer(&self.layers[*layer], kind, step)?;
                }
                if prior.is_sample_index(self) {
                    scene.sample_ior_offset = step;
                }
            }
        }
        scene.with_channels(channels)
    }
}

fn varied_layer(layer: &Layer, kind: PriorKind, step: f64) -> Result<Layer> {
    let roughness = layer.roughness() + if kind == PriorKind::Roughness { step } else { 0.0 };
    match layer.medium() {
        LayerMedium::Sample => Layer::sample(layer.name(), roughness),
        LayerMedium::Clear { ior, thickness_mm } => {
            let by = |own| if kind == own { step } else { 0.0 };
            let (ior, thickness) = (ior + by(PriorKind::Index), thickness_mm + by(PriorKind::Thickness));
            Layer::clear(layer.name(), ior, thickness, roughness)
        }
    }
}

#[cfg(test)]
mod tests;
