//! A stack of slabs in the place of a scene's sample, and its radiance factor over a base.

use nalgebra::{DMatrix, DVector, RowDVector};
use optics_model::angle::sin2;
use optics_model::phase::PhaseShape;
use optics_model::scene::LayerMedium;
use optics_model::{Medium, Scene};
use optics_tracer::face::Face;

use crate::faces::face;
use crate::operator::{Operator, solved};
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

/// A radiance factor over Lambertian bases of any reflectance: s + a ρ/(1 − b ρ).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Over a black base.
    pub over_black: f64,
    /// Share of the ring's light that comes to a base, times what a base of this radiance adds.
    pub through: f64,
    /// Share of the light of a base that comes back to it.
    pub returned: f64,
}

impl Level {
    /// Over a base of this reflectance.
    pub fn at(&self, rho: f64) -> f64 {
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
        let level = self.level(&self.slabs(slabs), &self.sensor(), &self.ring);
        rho.iter().map(|rho| level.at(*rho)).collect()
    }

    /// Share of even light from above that comes back in all directions, over Lambertian bases of these reflectances.
    pub fn reflectances(&self, slabs: &[PrintLayer], rho: &[f64]) -> Vec<f64> {
        let even = self.even(1.0);
        let all = RowDVector::from_fn(even.len(), |_, i| even[i] * self.quadrature.weights[i]);
        let level = self.level(&self.slabs(slabs), &all, &even);
        rho.iter().map(|rho| level.at(*rho)).collect()
    }

    /// Share of the light that passes the layers: the radiance at the sensor over that of even light in air below, without
    /// a base.
    pub fn transmittance(&self, slabs: &[PrintLayer]) -> f64 {
        let whole = self.top.over(&self.slabs(slabs)).over(&self.bottom);
        (self.sensor() * whole.up * self.even(1.0))[0]
    }

    /// All slabs as one layer.
    fn slabs(&self, slabs: &[PrintLayer]) -> Operator {
        let mut operators = slabs.iter().map(|slab| self.operator(slab));
        let first = operators.next().unwrap_or_else(|| Operator::none(self.quadrature.len()));
        operators.fold(first, |above, slab| above.over(&slab))
    }

    fn operator(&self, s: &PrintLayer) -> Operator {
        // A mean cosine at the limit of the lobes may lie beyond it by rounding.
        let phase = s.phase.function_near(s.medium.g());
        let depth = s.medium.sigma_t_per_mm() * s.thickness_mm;
        slab(&self.quadrature, self.sample_ior, &phase, s.medium.albedo(), depth)
    }

    /// What is seen in a sum over directions, of light from above.
    ///
    /// A base sends the same radiance x = ρ (c + b x) in all directions, c being the share of the light that reaches it.
    fn level(&self, slab: &Operator, seen: &RowDVector<f64>, light: &DVector<f64>) -> Level {
        let (top, bottom) = (&self.top, &self.bottom);
        let even = self.even(self.base_ior);
        let share = self.base_ior.powi(-2);
        let received = RowDVector::from_fn(even.len(), |_, i| share * even[i] * self.quadrature.weights[i]);
        let emitted = &bottom.up * &even;
        // From light that goes down above the slab, and from that of the base, to what goes down below it.
        let into = DMatrix::from_columns(&[&slab.reflects_below * &emitted]);
        let below = solved(&(&slab.reflects_below * &bottom.reflects_above), &append(&slab.down, &into));
        let n = even.len();
        let (down, base_down) = (below.columns(0, n), below.column(n).into_owned());
        // What goes up above it, without the light that the top returns, and with it.
        let reflected = &slab.reflects_above + &slab.up * (&bottom.reflects_above * down);
        let base_up = &slab.up * (&emitted + &bottom.reflects_above * &base_down);
        let entering = &top.down * light;
        let sources = DMatrix::from_columns(&[&reflected * &entering, base_up]);
        let up = solved(&(&reflected * &top.reflects_below), &sources);
        let back = &top.reflects_below * &up;
        let [of_light, of_base] = [down * (&entering + back.column(0)), base_down + down * back.column(1)];
        let reaches = &received * &bottom.down;
        let leaves = seen * &top.up;
        let number = |row: &RowDVector<f64>, column: &DVector<f64>| (row * column)[0];
        Level {
            over_black: number(seen, &(&top.reflects_above * light))
                + number(&leaves, &up.column(0).into_owned()),
            through: number(&reaches, &of_light) * number(&leaves, &up.column(1).into_owned()),
            returned: number(&received, &(&bottom.reflects_below * &even)) + number(&reaches, &of_base),
        }
    }

    /// The sensor's direction.
    fn sensor(&self) -> RowDVector<f64> {
        let sensor = self.quadrature.sensor();
        RowDVector::from_fn(self.quadrature.len(), |_, i| if i == sensor { 1.0 } else { 0.0 })
    }

    /// The same radiance in all directions of a medium.
    fn even(&self, ior: f64) -> DVector<f64> {
        let exists = |i: usize, _| if self.quadrature.exists(i, ior) { 1.0 } else { 0.0 };
        DVector::from_fn(self.quadrature.len(), exists)
    }
}

/// Columns after others.
fn append(matrix: &DMatrix<f64>, more: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = matrix.clone().resize_horizontally(matrix.ncols() + more.ncols(), 0.0);
    both.columns_mut(matrix.ncols(), more.ncols()).copy_from(more);
    both
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
