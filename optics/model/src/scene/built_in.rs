//! Defines the built-in scenes: the paper's set-up, the same in a real laboratory, and one with exact solutions.

use super::{Channel, Layer, Prior, PriorKind, RingLight, Scene, Scope, Sensor};
use crate::invalid::Result;
use crate::phase::{PhaseShape, SecondLobe};

impl Scene {
    /// Names of the built-in scenes.
    pub const NAMES: [&str; 3] = ["lab", "paper", "smooth"];

    /// The built-in scene of a name.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "lab" => Some(Self::lab()),
            "paper" => Some(Self::paper()),
            "smooth" => Some(Self::smooth()),
            _ => None,
        }
    }

    /// The set-up of the paper: glass slip, gel, rough sample, gel, coated signal source; R, G, B.
    pub fn paper() -> Self {
        let layers = vec![
            Layer::clear("glass slip", 1.52, 0.17, 0.0),
            Layer::clear("gel", 1.33, 0.02, 0.0),
            Layer::sample("sample", 0.05),
            Layer::clear("gel", 1.33, 0.02, 0.05),
            Layer::clear("coat", 1.49, 0.0, 0.15),
        ];
        Self::built_in(layers)
    }

    /// The set-up of the paper in a real laboratory: surfaces lose no light, pigments scatter some light back in a second
    /// lobe, and numbers that are rarely measured are uncertain.
    pub fn lab() -> Self {
        use PriorKind::{
            BaseSpread, DarkSide, Haze, Index, LightSide, RingAngle, Roughness, SecondLobeWeight, Thickness,
        };
        use Scope::{Material, Session, Slab};
        let [slip, gels, sample, faces, coat] = [vec![0], vec![1, 3], vec![2], vec![2, 3], vec![4]];
        let priors = [
            (Roughness, faces, 0.03, Material),
            (Roughness, coat.clone(), 0.05, Session),
            (Thickness, slip, 0.02, Session),
            (Thickness, gels.clone(), 0.02, Slab),
            (Index, gels, 0.01, Session),
            (Index, sample.clone(), 0.01, Material),
            (Index, coat, 0.03, Session),
            (SecondLobeWeight, sample, 0.05, Material),
            (RingAngle, Vec::new(), 1.0, Session),
            (BaseSpread, Vec::new(), 0.1, Session),
            (LightSide, Vec::new(), 0.015, Session),
            (DarkSide, Vec::new(), 0.01, Session),
            (Haze, Vec::new(), 0.01, Session),
        ];
        let prior = |(kind, layers, sd, scope)| Prior::new(kind, layers, sd, scope);
        let priors = priors.into_iter().map(prior).collect::<Result<_>>();
        let second_lobe = SecondLobe::new(0.05, -0.5).expect("both are in range");
        let scene = Self::paper().with_multiple_scattering(true).with_phase(PhaseShape::Lobes(second_lobe));
        priors.and_then(|priors| scene.with_priors(priors)).expect("the built-in scenes are valid")
    }

    /// The set-up of the paper with smooth interfaces and without the coat; it has exact solutions.
    pub fn smooth() -> Self {
        let layers = vec![
            Layer::clear("glass slip", 1.52, 0.17, 0.0),
            Layer::clear("gel", 1.33, 0.02, 0.0),
            Layer::sample("sample", 0.0),
            Layer::clear("gel", 1.33, 0.02, 0.0),
        ];
        Self::built_in(layers)
    }

    fn built_in(layers: Vec<Result<Layer>>) -> Self {
        let build = || {
            Self::new(
                layers.into_iter().collect::<Result<_>>()?,
                vec![
                    Channel::new("R", 0.985, 0.024)?,
                    Channel::new("G", 0.972, 0.023)?,
                    Channel::new("B", 0.971, 0.026)?,
                ],
                RingLight::new(40.0, 50.0)?,
                Sensor::new(10.0, 360, 0.0)?,
                false,
            )
        };
        build().expect("the built-in scenes are valid")
    }
}
