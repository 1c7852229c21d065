//! A stack of slabs in the place of a scene's sample, and its radiance factor over a base.

use nalgebra::{DMatrix, DVector, RowDVector};
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
    /// All that is above the slabs, and all below them.
    top: Operator,
    bottom: Operator,
    /// Radiance of the ring by direction: that of even light which is as bright on a horizontal surface.
    ring: DVector<f64>,
}

/// The light seen over Lambertian bases of any reflectance, as a function of it: s + a ρ/(1 − b ρ).
struct OverBase {
    /// Over a black base.
    over_black: f64,
    /// The light that reaches a base, times what a base adds that sends it back.
    through: f64,
    /// Share of a base's light that comes back to it.
    returned: f64,
}

impl OverBase {
    fn at(&self, rho: f64) -> f64 {
        self.over_black + self.through * rho / (1.0 - self.returned * rho)
    }
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
        let quadrature = Quadrature::new(&iors, sample_ior, peak, ring, sin2(scene.sensor().polar_deg()));
        let mut faces: Vec<(Face, Operator)> = Vec::new();
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
                let operator = known(&faces, &own).unwrap_or_else(|| face(&quadrature, &own));
                faces.push((own, operator.clone()));
                let side = sides.last_mut().expect("one, at least");
                *side = side.over(&operator);
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
        Self { quadrature, sample_ior, base_ior, top: sides.pop().unwrap_or(none), bottom, ring }
    }

    /// Radiance factors over Lambertian bases of these reflectances, with slabs from top to bottom.
    pub fn radiance_factors(&self, slabs: &[PrintLayer], rho: &[f64]) -> Vec<f64> {
        let seen = self.over_base(slabs, &self.sensor(), &self.ring);
        rho.iter().map(|rho| seen.at(*rho)).collect()
    }

    /// Share of even light from above that comes back in all directions, over Lambertian bases of these reflectances.
    pub fn reflectances(&self, slabs: &[PrintLayer], rho: &[f64]) -> Vec<f64> {
        let even = self.even(1.0);
        let all = RowDVector::from_fn(even.len(), |_, i| even[i] * self.quadrature.weights[i]);
        let seen = self.over_base(slabs, &all, &even);
        rho.iter().map(|rho| seen.at(*rho)).collect()
    }

    /// Share of the light that passes the layers: the radiance at the sensor over that of even light in air below, without
    /// a base.
    pub fn transmittance(&self, slabs: &[PrintLayer]) -> f64 {
        (self.whole(slabs).up * self.even(1.0))[self.quadrature.sensor()]
    }

    fn operator(&self, s: &PrintLayer) -> Operator {
        // A mean cosine at the limit of the lobes may lie beyond it by rounding.
        let phase = s.phase.function_near(s.medium.g());
        let depth = s.medium.sigma_t_per_mm() * s.thickness_mm;
        slab(&self.quadrature, self.sample_ior, &phase, s.medium.albedo(), depth)
    }

    /// The layers above the base as one.
    fn whole(&self, slabs: &[PrintLayer]) -> Operator {
        let slabs = slabs.iter().map(|slab| self.operator(slab));
        slabs.fold(self.top.clone(), |above, slab| above.over(&slab)).over(&self.bottom)
    }

    /// The sum over directions that is seen of light from above. A base sends the same radiance x = ρ (c + b x) in all
    /// directions, c being the light that reaches it.
    fn over_base(&self, slabs: &[PrintLayer], seen: &RowDVector<f64>, light: &DVector<f64>) -> OverBase {
        let whole = self.whole(slabs);
        let base = self.even(self.base_ior);
        let share = self.base_ior.powi(-2);
        let received = RowDVector::from_fn(base.len(), |_, i| share * base[i] * self.quadrature.weights[i]);
        let product =
            |row: &RowDVector<f64>, by: &DMatrix<f64>, column: &DVector<f64>| (row * (by * column))[0];
        OverBase {
            over_black: product(seen, &whole.reflects_above, light),
            through: product(&received, &whole.down, light) * product(seen, &whole.up, &base),
            returned: product(&received, &whole.reflects_below, &base),
        }
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
