//! Splits a ray at an interface, rough or smooth, into the rays that leave it, with the walk's own microfacets.
//!
//! Means over the points of a Kronecker sequence (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences")
//! integrate over visible normals.

use glam::Vec3;

use super::fresnel::{Facet, RelativeIndex, reflect, refract};
use super::microfacet::{masking, sample_visible_normal, split_until_out};
use super::rng::Stream;

/// Share of the light below which Russian roulette decides whether it is followed further on the microsurface.
const FAINT: f64 = 1e-2;

/// The interface between two media.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Face {
    /// Indices above and below.
    pub iors: [f64; 2],
    /// GGX α; 0 is smooth.
    pub roughness: f64,
    /// Whether light is followed until it leaves the microsurface.
    pub multiple_scattering: bool,
}

/// The side from which a ray comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaceSide {
    Above,
    Below,
}

/// A point of the unit cube.
#[derive(Debug, Clone, Copy)]
pub struct FacePoint {
    number: u32,
    /// Evenly spaced, for the direction of rays.
    pub u: f64,
    /// For the microfacet.
    normal: f32,
    azimuth_bits: u32,
}

impl FacePoint {
    /// A point of a sequence of `count`.
    pub fn new(number: u32, count: u32) -> Self {
        // 1/g and 1/g², g³ = g + 1.
        let shift = |step: f64| (0.5 + f64::from(number) * step).fract();
        Self {
            number,
            u: (f64::from(number) + 0.5) / f64::from(count),
            normal: shift(0.754_877_666_246_692_7) as f32,
            azimuth_bits: (65_536.0 * shift(0.569_840_290_998_053_2)) as u32,
        }
    }
}

/// A ray after a face: its direction, z > 0 on the side it came from, and its share of the light.
pub type FaceRay = (Vec3, f64);
pub type FaceRays = [Option<FaceRay>; 4];

impl Face {
    /// The rays into which a ray splits; `sin2` is sin² of its polar angle in the medium that it comes from.
    pub fn rays(&self, from: FaceSide, sin2: f64, point: FacePoint) -> FaceRays {
        let [above, below] = self.iors;
        let iors = if from == FaceSide::Above { [above, below] } else { [below, above] };
        let wi = Vec3::new(0.0, sin2.sqrt() as f32, (1.0 - sin2).sqrt() as f32);
        let indices = [RelativeIndex::new(iors[0], iors[1]), RelativeIndex::new(iors[1], iors[0])];
        let alpha = self.roughness as f32;
        let m = if alpha > 0.0 {
            sample_visible_normal(wi, alpha, point.normal, point.azimuth_bits)
        } else {
            Vec3::Z
        };
        if self.multiple_scattering && alpha > 0.0 {
            let stream = &mut Stream::new([iors[0].to_bits() as u32, 47], 0, point.number);
            return split_until_out(wi, m, alpha, indices, FAINT, stream).map(Some);
        }
        let [up, down] = split(wi, m, alpha, indices[0]);
        [up, down, None, None]
    }
}

/// The reflected and the refracted ray at a facet; a ray that ends on the wrong side is lost, as in the walk.
fn split(wi: Vec3, m: Vec3, alpha: f32, index: RelativeIndex) -> [Option<FaceRay>; 2] {
    let cos_i = wi.dot(m);
    let facet = Facet::new(cos_i, index);
    let reflectance = if facet.cos_t > 0.0 { f64::from(facet.reflectance()) } else { 1.0 };
    let up = reflect(wi, m, cos_i);
    let down = refract(wi, m, cos_i, facet.cos_t, index.eta);
    let weighed = |d: Vec3, cos: f32, part: f64| {
        let masked = if alpha > 0.0 { masking(cos, d.x * d.x + d.y * d.y, alpha) } else { 1.0 };
        (cos > 0.0 && part > 0.0).then(|| (d, part * f64::from(masked)))
    };
    [weighed(up, up.z, reflectance), weighed(down, -down.z, 1.0 - reflectance)]
}
