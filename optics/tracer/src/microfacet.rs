//! Samples reflection and refraction at rough interfaces: the GGX microsurface with Smith shadowing.
//!
//! Directions point away from the interface; the incident side is z > 0.

use std::f32::consts::LN_2;

use glam::Vec3;

use super::fresnel::{Facet, RelativeIndex, reflect, refract};
use super::math::{pow, unit_vector};
use super::rng::{Stream, uniform};

/// Samples the normals visible from `wi` (any unit vector, also from below) on a GGX surface with roughness
/// `alpha`: density D(m) max(0, wi·m) normalised. `bits` give the azimuth.
///
/// Spherical caps after Dupuy and Benyoub 2023 ("Sampling visible GGX normals with spherical caps"), the same
/// distribution as Heitz 2018 ("Sampling the GGX distribution of visible normals").
pub fn sample_visible_normal(wi: Vec3, alpha: f32, u: f32, bits: u32) -> Vec3 {
    let stretched = stretch(wi, alpha);
    // h = c + stretched with c on a cap; h.z is formed directly, since c.z + stretched.z would cancel.
    let h_z = (1.0 - u) * (1.0 + stretched.z);
    let c_z = h_z - stretched.z;
    let sin = (1.0 - c_z * c_z).max(0.0).sqrt();
    let (x, y) = unit_vector(bits);
    let h = Vec3::new(sin * x + stretched.x, sin * y + stretched.y, h_z);
    unit(Vec3::new(alpha * h.x, alpha * h.y, h.z))
}

/// The direction on the surface stretched to roughness 1.
fn stretch(wi: Vec3, alpha: f32) -> Vec3 {
    unit(Vec3::new(alpha * wi.x, alpha * wi.y, wi.z))
}

fn unit(v: Vec3) -> Vec3 {
    v * (1.0 / (v.x * v.x + v.y * v.y + v.z * v.z).sqrt())
}

/// Smith's masking of a direction by its own side of the surface:
/// G1 = 2 / (1 + √(1 + α² tan² θ)), with `cos` = |cos θ| and `sin2` = sin² θ.
pub fn masking(cos: f32, sin2: f32, alpha: f32) -> f32 {
    (cos + cos) / (cos + (cos * cos + alpha * alpha * sin2).sqrt())
}

/// A ray that has left the interface.
#[derive(Debug, Clone, Copy)]
pub struct Scattered {
    /// z > 0 on the incident side, z < 0 on the other.
    pub direction: Vec3,
    pub weight: f32,
}

/// One reflection or refraction at a visible facet, weight G2/G1 = G1(wo) (uncorrelated Smith), as in Mitsuba's
/// `roughdielectric`. A direction that ends on the wrong side is lost: None. Uses the last three words.
pub fn scatter_once(wi: Vec3, alpha: f32, index: RelativeIndex, words: [u32; 4]) -> Option<Scattered> {
    let m = sample_visible_normal(wi, alpha, uniform(words[1]), words[2]);
    let cos_i = wi.dot(m);
    let facet = Facet::new(cos_i, index);
    let (direction, cos) = if facet.reflects(uniform(words[3])) {
        let wo = reflect(wi, m, cos_i);
        (wo, wo.z)
    } else {
        let wo = refract(wi, m, cos_i, facet.cos_t, index.eta);
        (wo, -wo.z)
    };
    let sin2 = direction.x * direction.x + direction.y * direction.y;
    (cos > 0.0).then(|| Scattered { direction, weight: masking(cos, sin2, alpha) })
}

/// Follows the ray on the microsurface until it leaves, losing nothing (Heitz et al. 2016, "Multiple-scattering
/// microfacet BSDFs with the Smith model", uniform height distribution). `indices` are the indices of the incident side
/// and of the other. Most rays leave after one event, for which `words` suffice; the others draw from the stream.
pub fn scatter_until_out(
    wi: Vec3,
    alpha: f32,
    indices: [RelativeIndex; 2],
    words: [u32; 4],
    stream: &mut Stream,
) -> Vec3 {
    let (u, level) = (uniform(words[0]), level(words[2]));
    let ray = SurfaceRay::meet(wi, alpha, level).scatter(alpha, indices, words);
    // The level of the height from the ray's side, or less.
    let level = if ray.incident_side { level } else { stretch(wi, alpha).z * (1.0 - level) };
    if ray.clears(alpha, u, level) { ray.outgoing() } else { ray.follow(alpha, indices, u, stream) }
}

/// Follows a ray with a given first normal until it leaves, losing nothing. Returns all directions in which light leaves,
/// with their shares: light reflected once, light refracted once, and of the light that then meets the surface again, one
/// random path for each. Paths with a share below `faint` are subject to Russian roulette.
pub fn split_until_out(
    wi: Vec3,
    m: Vec3,
    alpha: f32,
    indices: [RelativeIndex; 2],
    faint: f64,
    stream: &mut Stream,
) -> [(Vec3, f64); 4] {
    let meeting = SurfaceRay::meet(wi, alpha, level(stream.words()[2]));
    let cos_i = wi.dot(m);
    let facet = Facet::new(cos_i, indices[0]);
    let reflectance = if facet.cos_t > 0.0 { f64::from(facet.reflectance()) } else { 1.0 };
    let reflected = meeting.reflect(m, cos_i);
    let refracted = meeting.refract(m, cos_i, facet.cos_t, indices[0].eta);
    let mut leave = |ray: SurfaceRay, share: f64| {
        let leaving = ray.leaving(alpha);
        let at_once = (ray.outgoing(), share * f64::from(leaving));
        let rest = share * (1.0 - f64::from(leaving));
        let [chance, next, ..] = if rest > 0.0 { stream.words().map(uniform) } else { [1.0; 4] };
        if f64::from(chance) * faint >= rest {
            return [at_once, (ray.outgoing(), 0.0)];
        }
        let later = ray.follow(alpha, indices, (1.0 - leaving) * next, stream);
        [at_once, (later, rest.max(faint))]
    };
    let [a, b] = leave(reflected, reflectance);
    let [c, d] = leave(refracted, 1.0 - reflectance);
    [a, b, c, d]
}

/// Uniform number from the upper 16 random bits: the midpoint of one of 2¹⁶ equal cells of (0, 1).
pub fn level(bits: u32) -> f32 {
    f32::from_bits((bits >> 9 & 0x007f_ff80) | 0x3f80_0000) - (1.0 - 1.0 / 131_072.0)
}

/// Upper estimate of −ln x for 0 ≤ x ≤ 1: the bits of a float are nearly its logarithm.
pub fn minus_ln_at_most(x: f32) -> f32 {
    (0x3f80_0000 - x.to_bits() as i32) as f32 * (LN_2 / 8_388_608.0)
}

/// A ray at the microsurface.
///
/// Heights are kept as their distribution function c in (0, 1). Seen from below, the surface is the same surface
/// with c → 1 − c and z → −z.
#[derive(Debug, Clone, Copy)]
struct SurfaceRay {
    /// Direction of flight; z > 0 leads out of the surface.
    direction: Vec3,
    c: f32,
    /// Whether it is on the side from which it came.
    incident_side: bool,
}

impl SurfaceRay {
    /// Meets the surface from far away, at the height of a level, uniform in (0, 1).
    fn meet(wi: Vec3, alpha: f32, level: f32) -> Self {
        let lambda = smith_lambda(wi, alpha);
        Self { direction: -wi, c: edged(pow(level, 1.0 / (1.0 + lambda))), incident_side: true }
    }

    fn reflect(self, m: Vec3, cos_i: f32) -> Self {
        Self { direction: reflect(-self.direction, m, cos_i), ..self }
    }

    fn refract(self, m: Vec3, cos_i: f32, cos_t: f32, eta: f32) -> Self {
        let t = refract(-self.direction, m, cos_i, cos_t, eta);
        let direction = Vec3::new(t.x, t.y, -t.z);
        Self { direction, c: 1.0 - self.c, incident_side: !self.incident_side }
    }

    /// Reflects or refracts the ray at a facet that is visible to it.
    fn scatter(self, alpha: f32, indices: [RelativeIndex; 2], words: [u32; 4]) -> Self {
        let w = -self.direction;
        let m = sample_visible_normal(w, alpha, uniform(words[1]), words[2]);
        let cos_i = w.dot(m);
        let index = indices[usize::from(!self.incident_side)];
        let facet = Facet::new(cos_i, index);
        if facet.reflects(uniform(words[3])) {
            self.reflect(m, cos_i)
        } else {
            self.refract(m, cos_i, facet.cos_t, index.eta)
        }
    }

    /// Probability c^Λ that the ray leaves without another event.
    fn leaving(self, alpha: f32) -> f32 {
        if self.direction.z > 0.0 { pow(self.c, smith_lambda(self.direction, alpha)) } else { 0.0 }
    }

    /// Whether the ray leaves by a bound of that probability that needs no power: u ≥ 1 − c^Λ where u ≥ −Λ ln c.
    /// `level` is not above c. This is part of the walk's definition, so that the vector kernel can decide by it.
    fn clears(self, alpha: f32, u: f32, level: f32) -> bool {
        let Vec3 { x, y, z } = self.direction;
        let slant = (z * z + (x * x + y * y) * (alpha * alpha)).sqrt();
        (slant - z) * minus_ln_at_most(level) < (z + z) * u
    }

    /// Follows the ray until it leaves. `u` decides about its next event, as it did in [`Self::clears`].
    fn follow(mut self, alpha: f32, indices: [RelativeIndex; 2], mut u: f32, stream: &mut Stream) -> Vec3 {
        loop {
            let lambda = smith_lambda(self.direction, alpha);
            let c = if self.direction.z <= 0.0 {
                self.c * pow(1.0 - u, 1.0 / (1.0 + lambda))
            } else if 1.0 - u < pow(self.c, lambda) {
                return self.outgoing();
            } else {
                self.c / pow(1.0 - u, 1.0 / lambda)
            };
            let words = stream.words();
            self = Self { c: edged(c), ..self }.scatter(alpha, indices, words);
            u = uniform(words[0]);
        }
    }

    /// Direction after it has left, with z > 0 on the incident side.
    fn outgoing(self) -> Vec3 {
        let Vec3 { x, y, z } = self.direction;
        Vec3::new(x, y, if self.incident_side { z } else { -z })
    }
}

/// Keeps c and 1 − c representable and away from 0.
fn edged(c: f32) -> f32 {
    const EDGE: f32 = 1e-6;
    c.clamp(EDGE, 1.0 - EDGE)
}

/// Smith's Λ = (√(1 + α² tan² θ) − 1)/2.
fn smith_lambda(d: Vec3, alpha: f32) -> f32 {
    let tan2 = (d.x * d.x + d.y * d.y) / (d.z * d.z);
    0.5 * ((1.0 + alpha * alpha * tan2).sqrt() - 1.0)
}

#[cfg(test)]
mod tests;
