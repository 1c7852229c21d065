//! A stack of slabs in the place of a scene's sample, and its radiance factor over a base.

use std::sync::Arc;

use nalgebra::{DVector, RowDVector};
use optics_model::angle::sin2;
use optics_model::controls::NARROWEST_PEAK;
use optics_model::phase::{PhaseFunction, PhaseShape};
use optics_model::scene::{Layer, LayerMedium};
use optics_model::{Medium, Scene};
use optics_tracer::face::Face;

use crate::faces::face;
use crate::operator::{Covered, Operator, OverBase};
use crate::quadrature::{NodeCounts, Quadrature};
use crate::remembered::Remembered;
use crate::slab::MediumSlab;

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
    /// All that is above the slabs, and all below them.
    top: Operator,
    bottom: Operator,
    /// Radiance of the ring by direction: that of even light which is as bright on a horizontal surface.
    ring: DVector<f64>,
    /// The numbers that all this follows from, as bits.
    key: Vec<u64>,
}

impl Print {
    /// Greatest |g| of a lobe that the directions resolve to 1 %.
    pub const MOST_G: f64 = 1.0 - NARROWEST_PEAK;

    /// A scene whose sample has this index, for slabs whose phase functions have peaks of at least this width
    /// (`PhaseFunction::peak_width`: 1 − |g| of a lobe). Channels, phase function and uncertain quantities of the scene are
    /// not used.
    pub fn new(scene: &Scene, sample_ior: f64, peak: f64) -> Self {
        Self::with(scene, sample_ior, NodeCounts::fine(peak))
    }

    /// Like [`Self::new`] with few directions, which err by 0.3 %: for fits whose results are compared with those of all
    /// directions at their end.
    pub fn coarse(scene: &Scene, sample_ior: f64) -> Self {
        Self::with(scene, sample_ior, NodeCounts::COARSE)
    }

    /// Like [`Self::new`] with as many directions as standard errors need, which err by 1 %.
    pub fn for_slopes(scene: &Scene, sample_ior: f64, peak: f64) -> Self {
        Self::with(scene, sample_ior, NodeCounts::slopes(peak))
    }

    fn with(scene: &Scene, sample_ior: f64, counts: NodeCounts) -> Self {
        let ior = |layer: &Layer| match layer.medium() {
            LayerMedium::Clear { ior, .. } => ior,
            LayerMedium::Sample => sample_ior,
        };
        let iors: Vec<f64> = std::iter::once(1.0).chain(scene.layers().iter().map(ior)).collect();
        let ring = [scene.light().inner_deg(), scene.light().outer_deg()].map(sin2);
        let quadrature = Quadrature::new(&iors, sample_ior, counts, ring, sin2(scene.sensor().polar_deg()));
        let none = Operator::none(quadrature.len());
        // Above the sample and from there on.
        let mut sides = vec![none.clone()];
        for (i, layer) in scene.layers().iter().enumerate() {
            // Between layers of one index there is no interface.
            if iors[i] != iors[i + 1] {
                let own = Face {
                    iors: [iors[i], iors[i + 1]],
                    roughness: layer.roughness(),
                    multiple_scattering: scene.multiple_scattering(),
                };
                let side = sides.last_mut().expect("one, at least");
                *side = side.over(&face(&quadrature, &own));
            }
            if layer.medium() == LayerMedium::Sample {
                sides.push(none.clone());
            }
        }
        let bottom = sides.pop().unwrap_or_else(|| none.clone());
        let measure = scene.light().measure();
        // Smooth faces mirror the ring in the sensor's own direction.
        let is_lit = |i: usize| match quadrature.sensor() {
            sensor if sensor == i => (ring[0]..=ring[1]).contains(&quadrature.s2[i]),
            _ => quadrature.is_lit(i),
        };
        let ring = DVector::from_fn(quadrature.len(), |i, _| if is_lit(i) { 1.0 / measure } else { 0.0 });
        let base_ior = *iors.last().expect("air, at least");
        let key = looks(scene).chain(quadrature.key().iter().copied()).collect();
        Self { quadrature, sample_ior, base_ior, top: sides.pop().unwrap_or(none), bottom, ring, key }
    }

    /// Like [`Self::new`], but what is the same for many media is computed once.
    pub(crate) fn remembered(scene: &Scene, sample_ior: f64, peak: f64) -> Arc<Self> {
        static KNOWN: Remembered<Arc<Print>> = Remembered::new(64);
        let numbers = [sample_ior, peak].map(f64::to_bits);
        KNOWN.get(looks(scene).chain(numbers).collect(), || Arc::new(Self::new(scene, sample_ior, peak)))
    }

    /// Radiance factors over Lambertian bases of these reflectances, with slabs from top to bottom.
    pub fn radiance_factors(&self, slabs: &[PrintLayer], rho: &[f64]) -> Vec<f64> {
        let slabs: Vec<_> = slabs.iter().map(|slab| Arc::new(self.operator(slab))).collect();
        self.factors(&slabs, rho)
    }

    /// Radiance factors over Lambertian bases of these reflectances, under the layers of these operators.
    pub(crate) fn factors(&self, slabs: &[Arc<Operator>], rho: &[f64]) -> Vec<f64> {
        let covered = slabs.iter().rev().fold(self.base(), |below, slab| below.under(slab));
        let seen = self.seen(&covered);
        rho.iter().map(|rho| seen.at(*rho)).collect()
    }

    /// Share of even light from above that comes back in all directions, over Lambertian bases of these reflectances.
    pub fn reflectances(&self, slabs: &[PrintLayer], rho: &[f64]) -> Vec<f64> {
        let even = self.even(1.0);
        let all = RowDVector::from_fn(even.len(), |_, i| even[i] * self.quadrature.weights[i]);
        let slabs = slabs.iter().rev().map(|slab| self.operator(slab));
        let covered = slabs.fold(self.base(), |below, slab| below.under(&slab));
        let seen = covered.seen_above(&self.top, &all, &even);
        rho.iter().map(|rho| seen.at(*rho)).collect()
    }

    /// Share of the light that passes the layers: the radiance at the sensor over that of even light in air below, without
    /// a base.
    pub fn transmittance(&self, slabs: &[PrintLayer]) -> f64 {
        let slabs = slabs.iter().map(|slab| self.operator(slab));
        let whole = slabs.fold(self.top.clone(), |above, slab| above.over(&slab)).over(&self.bottom);
        (whole.up * self.even(1.0))[self.quadrature.sensor()]
    }

    pub(crate) fn operator(&self, s: &PrintLayer) -> Operator {
        // A mean cosine at the limit of the lobes may lie beyond it by rounding.
        let phase = s.phase.function_near(s.medium.g());
        self.slab(&phase, s.medium.albedo(), s.medium.sigma_t_per_mm() * s.thickness_mm).operator()
    }

    /// A slab of an optical thickness.
    pub(crate) fn slab(&self, phase: &PhaseFunction, albedo: f64, depth: f64) -> MediumSlab {
        MediumSlab::new(&self.quadrature, self.sample_ior, phase, albedo, depth)
    }

    /// The radiance factor of a slab.
    pub(crate) fn level(&self, slab: &MediumSlab) -> OverBase {
        self.seen(&self.base().under(&slab.clone().operator()))
    }

    /// The numbers that a print follows from, as bits.
    pub(crate) fn key(&self) -> &[u64] {
        &self.key
    }

    /// The base and slabs on it as they are seen. A base sends the same radiance x = ρ (c + b x) in all directions, c being
    /// the light that reaches it.
    pub(crate) fn seen(&self, covered: &Covered) -> OverBase {
        covered.seen_above(&self.top, &self.sensor(), &self.ring)
    }

    /// The base and all that is below the slabs.
    pub(crate) fn base(&self) -> Covered {
        let base = self.even(self.base_ior);
        let share = self.base_ior.powi(-2);
        let received = RowDVector::from_fn(base.len(), |_, i| share * base[i] * self.quadrature.weights[i]);
        Covered::new(&self.bottom, &base, &received)
    }

    /// The sensor's direction.
    fn sensor(&self) -> RowDVector<f64> {
        let sensor = self.quadrature.sensor();
        RowDVector::from_fn(self.quadrature.len(), |_, i| if i == sensor { 1.0 } else { 0.0 })
    }

    /// Light with the same radiance in all directions of a medium.
    fn even(&self, ior: f64) -> DVector<f64> {
        let exists = |i: usize, _| if self.quadrature.exists(i, ior) { 1.0 } else { 0.0 };
        DVector::from_fn(self.quadrature.len(), exists)
    }
}

/// The numbers of a scene that a print depends on, besides the index of its sample, as bits.
fn looks(scene: &Scene) -> impl Iterator<Item = u64> {
    let layer = |layer: &Layer| match layer.medium() {
        LayerMedium::Clear { ior, .. } => [ior, layer.roughness()],
        LayerMedium::Sample => [0.0, layer.roughness()],
    };
    let (light, losing) = (scene.light(), f64::from(u8::from(!scene.multiple_scattering())));
    let others = [light.inner_deg(), light.outer_deg(), scene.sensor().polar_deg(), losing];
    scene.layers().iter().flat_map(layer).chain(others).map(f64::to_bits).collect::<Vec<_>>().into_iter()
}

#[cfg(test)]
mod tests;
