//! Prepares a scene and a transport point for walks: slabs, interfaces, sensor and ring in single precision.

use glam::Vec3;
use optics_model::angle::sin2;
use optics_model::scene::LayerMedium;
use optics_model::{Scene, TransportPoint};

use super::fresnel::RelativeIndex;
use super::phase::PhaseSampler;

/// A plane interface, seen from both sides.
#[derive(Debug, Clone, Copy)]
pub struct Interface {
    pub from_above: RelativeIndex,
    pub from_below: RelativeIndex,
    /// GGX roughness; 0 is smooth.
    pub alpha: f32,
}

/// A scene at one transport point, prepared for walks. Lengths in the sample are in mean free paths: points of the same
/// optical thickness have the same stack.
#[derive(Debug, Clone)]
pub struct Stack {
    /// Thickness in mm of each slab from top to bottom; slab 0 is the air above, the base lies under the last. The
    /// sample's thickness is in mean free paths.
    pub thickness: Vec<f32>,
    /// Refractive index of each slab.
    pub iors: Vec<f64>,
    /// `interfaces[i]` lies between slab i and slab i + 1.
    pub interfaces: Vec<Interface>,
    /// The slab that scatters.
    pub sample: usize,
    pub phase: PhaseSampler,
    /// Direction in which walks leave the sensor, in air.
    pub sensor_direction: Vec3,
    /// Bounds of sin² of the polar angle in air between which the light is seen.
    pub ring_sin2: [f32; 2],
    pub multiple_scattering: bool,
    /// [`Scene::base_spread_mm`].
    pub base_spread_mm: f32,
}

impl Stack {
    pub fn new(scene: &Scene, point: &TransportPoint) -> Self {
        let mut iors = vec![1.0];
        let mut thickness = vec![0.0];
        let mut sample = 0;
        for layer in scene.layers() {
            let (ior, slab) = match layer.medium() {
                LayerMedium::Clear { ior, thickness_mm } => (ior, thickness_mm as f32),
                LayerMedium::Sample => {
                    sample = thickness.len();
                    (point.sample_ior() + scene.sample_ior_offset(), point.walked_slab().optical_thickness)
                }
            };
            iors.push(ior);
            thickness.push(slab);
        }
        let interface = |i: usize| Interface {
            from_above: RelativeIndex::new(iors[i], iors[i + 1]),
            from_below: RelativeIndex::new(iors[i + 1], iors[i]),
            alpha: scene.layers()[i].roughness() as f32,
        };
        let (light, polar) = (scene.light(), scene.sensor().polar_deg());
        // A ring that reaches the horizon or the zenith must not lose directions to rounding.
        let inner = if light.inner_deg() == 0.0 { -1.0 } else { sin2(light.inner_deg()) as f32 };
        let outer = if light.outer_deg() == 90.0 { 2.0 } else { sin2(light.outer_deg()) as f32 };
        let (sin_polar, cos_polar) = (sin2(polar).sqrt(), (1.0 - sin2(polar)).sqrt());
        Self {
            interfaces: (0..scene.layers().len()).map(interface).collect(),
            thickness,
            iors,
            sample,
            // Jobs are refused whose g is none of the scene's phase function.
            phase: PhaseSampler::new(&scene.phase().function_near(point.g())),
            sensor_direction: Vec3::new(0.0, sin_polar as f32, -cos_polar as f32),
            ring_sin2: [inner, outer],
            multiple_scattering: scene.multiple_scattering(),
            base_spread_mm: scene.base_spread_mm() as f32,
        }
    }
}
