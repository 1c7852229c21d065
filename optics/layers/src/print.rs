//! A stack of slabs in the place of a scene's sample, and its radiance factor over a base.

use nalgebra::{DMatrix, DVector};
use optics_model::angle::sin2;
use optics_model::phase::PhaseShape;
use optics_model::scene::LayerMedium;
use optics_model::{Medium, Scene};
use optics_tracer::face::Face;

use crate::faces::face;
use crate::operator::Operator;
use crate::quadrature::Quadrature;
use crate::slab::slab;

/// A slab of a medium.
#[derive(Debug, Clone, PartialEq)]
pub struct PrintLayer {
    pub medium: Medium,
    pub phase: PhaseShape,
    pub thickness_mm: f64,
}

/// The layers of a scene, without their slabs: faces, which take the longest to compute, ring and sensor.
#[derive(Debug)]
pub struct Print {
    quadrature: Quadrature,
    sample_ior: f64,
    /// Index of the lowest layer, which the base touches.
    base_ior: f64,
    /// From top to bottom; None stands for the slabs.
    elements: Vec<Option<Operator>>,
    /// Indices of the nodes within the ring, and its measure sin²θ_outer − sin²θ_inner.
    lit: Vec<usize>,
    ring: f64,
    /// Whether the sensor's mirror direction lies within the ring.
    is_mirrored: bool,
}

impl Print {
    /// Greatest |g| of a lobe that the directions resolve to 1 %.
    pub const MOST_G: f64 = 0.96;

    /// A scene whose sample has this index, for slabs whose phase functions have peaks of at least this width
    /// (`PhaseFunction::peak_width`: 1 − |g| of a lobe). Channels, phase function and uncertain quantities of the scene are
    /// not used.
    pub fn new(scene: &Scene, sample_ior: f64, peak: f64) -> Self {
        let ior = |layer: &optics_model::scene::Layer| match layer.medium() {
            LayerMedium::Clear { ior, .. } => ior,
            LayerMedium::Sample => sample_ior,
        };
        let iors: Vec<f64> = std::iter::once(1.0).chain(scene.layers().iter().map(ior)).collect();
        let ring = [scene.light().inner_deg(), scene.light().outer_deg()].map(sin2);
        let sines = ring.map(f64::sqrt);
        let rough =
            scene.layers().iter().map(optics_model::scene::Layer::roughness).filter(|alpha| *alpha > 0.0);
        let roughness = rough.min_by(f64::total_cmp);
        let sensor = sin2(scene.sensor().polar_deg());
        let quadrature = Quadrature::new(&iors, sample_ior, roughness, peak, sines, sensor);
        let mut faces: Vec<(Face, Operator)> = Vec::new();
        let mut elements = Vec::new();
        for (i, layer) in scene.layers().iter().enumerate() {
            // Between layers of one index there is no interface.
            if iors[i] != iors[i + 1] {
                let own = Face {
                    iors: [iors[i], iors[i + 1]],
                    roughness: layer.roughness(),
                    multiple_scattering: scene.multiple_scattering(),
                };
                let operator =
                    known(&faces, &own).unwrap_or_else(|| face(&quadrature, &own, sines[1] - sines[0]));
                faces.push((own, operator.clone()));
                elements.push(Some(operator));
            }
            if layer.medium() == LayerMedium::Sample {
                elements.push(None);
            }
        }
        let is_lit =
            |i: &usize| (ring[0]..=ring[1]).contains(&quadrature.s2[*i]) && quadrature.weights[*i] > 0.0;
        let lit = (0..quadrature.len()).filter(is_lit).collect();
        let base_ior = *iors.last().expect("air, at least");
        let is_mirrored = (ring[0]..=ring[1]).contains(&quadrature.s2[quadrature.sensor()]);
        Self { quadrature, sample_ior, base_ior, elements, lit, ring: scene.light().measure(), is_mirrored }
    }

    /// Radiance factors over Lambertian bases of these reflectances, with slabs from top to bottom.
    pub fn radiance_factors(&self, slabs: &[PrintLayer], rho: &[f64]) -> Vec<f64> {
        let slabs: Vec<Operator> = slabs.iter().map(|s| self.operator(s)).collect();
        rho.iter().map(|rho| self.radiance_factor(&slabs, *rho)).collect()
    }

    /// Share of the light that passes the layers: the radiance at the sensor over that of even light in air below, without
    /// a base.
    pub fn transmittance(&self, slabs: &[PrintLayer]) -> f64 {
        let slabs: Vec<Operator> = slabs.iter().map(|s| self.operator(s)).collect();
        let n = self.quadrature.len();
        let mut reflection = DMatrix::zeros(n, n);
        let below = |i: usize, _| if self.quadrature.exists(i, 1.0) { 1.0 } else { 0.0 };
        let mut light = DVector::from_fn(n, below);
        let layers = self.elements.iter().rev().flat_map(|element| match element {
            Some(face) => vec![face],
            None => slabs.iter().rev().collect(),
        });
        for layer in layers {
            light = layer.passed(&reflection, &light);
            reflection = layer.over(&reflection);
        }
        light[self.quadrature.sensor()]
    }

    fn operator(&self, s: &PrintLayer) -> Operator {
        // A mean cosine at the limit of the lobes may lie beyond it by rounding.
        let phase = s.phase.function_near(s.medium.g());
        let depth = s.medium.sigma_t_per_mm() * s.thickness_mm;
        slab(&self.quadrature, self.sample_ior, &phase, s.medium.albedo(), depth)
    }

    /// Share of even light from above that comes back in all directions, over Lambertian bases of these reflectances.
    pub fn reflectances(&self, slabs: &[PrintLayer], rho: &[f64]) -> Vec<f64> {
        let slabs: Vec<Operator> = slabs.iter().map(|s| self.operator(s)).collect();
        let in_air: Vec<usize> =
            (0..self.quadrature.len()).filter(|i| self.quadrature.exists(*i, 1.0)).collect();
        let of = |rho: &f64| {
            let reflection = self.reflection(&slabs, *rho);
            let leaves = |i: usize| in_air.iter().map(|j| reflection[(i, *j)]).sum::<f64>();
            in_air.iter().map(|i| self.quadrature.weights[*i] * leaves(*i)).sum()
        };
        rho.iter().map(of).collect()
    }

    fn radiance_factor(&self, slabs: &[Operator], rho: f64) -> f64 {
        let reflection = self.reflection(slabs, rho);
        let sensor = self.quadrature.sensor();
        // Smooth faces mirror the ring in the sensor's own direction.
        let lit = self.lit.iter().chain(self.is_mirrored.then_some(&sensor));
        lit.map(|j| reflection[(sensor, *j)]).sum::<f64>() / self.ring
    }

    /// The reflection of all layers over a Lambertian base.
    fn reflection(&self, slabs: &[Operator], rho: f64) -> DMatrix<f64> {
        self.elements.iter().rev().fold(self.base(rho), |below, element| match element {
            Some(face) => face.over(&below),
            None => slabs.iter().rev().fold(below, |below, slab| slab.over(&below)),
        })
    }

    /// A Lambertian base sends the same radiance in all directions.
    fn base(&self, rho: f64) -> DMatrix<f64> {
        let n2 = self.base_ior * self.base_ior;
        let of = |i: usize, j: usize| {
            let exist = [i, j].iter().all(|k| self.quadrature.exists(*k, self.base_ior));
            if exist { rho * self.quadrature.weights[j] / n2 } else { 0.0 }
        };
        DMatrix::from_fn(self.quadrature.len(), self.quadrature.len(), of)
    }
}

/// The operator of a face like an earlier one, or like one upside down.
fn known(faces: &[(Face, Operator)], own: &Face) -> Option<Operator> {
    let turned = Face { iors: [own.iors[1], own.iors[0]], ..*own };
    faces.iter().find_map(|(face, operator)| match () {
        () if face == own => Some(operator.clone()),
        () if *face == turned => Some(operator.turned()),
        () => None,
    })
}

#[cfg(test)]
mod tests;
