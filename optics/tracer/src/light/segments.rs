//! Light that meets interfaces only, from the ring to the segments that it crosses the sample in, and to the base.
//!
//! At every interface light goes both ways, with the shares that Fresnel gives; what is faint ends or goes on by chance.
//! The ring's angles and the first rough face's normals come from a Kronecker sequence (Roberts 2018, "The unreasonable
//! effectiveness of quasirandom sequences"), others from streams with a key of their own. Rays carry flux, and the
//! interfaces are reciprocal, so that each is crossed as walks cross it.

use glam::Vec3;

use crate::fresnel::{Facet, reflect, refract};
use crate::microfacet::{masking, sample_visible_normal, scatter_until_out};
use crate::rng::{Stream, uniform};
use crate::stack::Stack;

/// Cells of the cosine into which segments are gathered.
const CELLS: usize = 128;
/// Rays that set out from the ring where all interfaces are smooth, where some are rough, and where rays are followed on
/// the microsurface, one way at a time.
const RAYS: [u32; 3] = [256, 1024, 1 << 15];
/// Share of a ray's flux at which it becomes a matter of chance whether it goes on.
const FAINT: f64 = 2e-3;
/// Interfaces after which light is let go. Only a ray that rounding has caught between two faces that reflect totally meets
/// so many.
const MOST_INTERFACES: u32 = 1000;
const KEY: [u32; 2] = [0x9d1f_3c55, 0x27d4_eb2f];

/// Segments of the same direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Whether it begins at the upper face.
    pub down: bool,
    /// |cos θ|, the mean over a cell.
    pub cosine: f64,
    /// Share of the ring's light where it begins.
    pub flux: f64,
}

#[derive(Debug)]
pub struct Segments {
    /// Flux, and flux times cosine, of segments that begin at the upper and at the lower face.
    cells: [Vec<[f64; 2]>; 2],
    /// Flux that comes to the base, and the same times its length in the sample.
    pub base: f64,
    base_lengths: f64,
}

/// Light on its way, at the beginning of a slab.
struct Way {
    slab: usize,
    direction: Vec3,
    flux: f64,
    length_mm: f64,
    /// Interfaces met so far, and rough ones.
    interfaces: u32,
    rough: u32,
}

impl Segments {
    pub fn follow(stack: &Stack, [inner, outer]: [f64; 2]) -> Self {
        let rough = stack.interfaces.iter().any(|i| i.alpha > 0.0);
        let rays = RAYS[if rough { 1 + usize::from(stack.multiple_scattering) } else { 0 }];
        let share = 1.0 / f64::from(rays);
        let empty = || vec![[0.0; 2]; CELLS];
        let mut segments = Self { cells: [empty(), empty()], base: 0.0, base_lengths: 0.0 };
        let mut ways = Vec::new();
        for ray in 0..rays {
            let mut stream = Stream::new(KEY, 0, ray);
            let sin2 = inner + (outer - inner) * (f64::from(ray) + 0.5) * share;
            let direction = Vec3::new(sin2.sqrt() as f32, 0.0, -((1.0 - sin2).sqrt() as f32));
            ways.push(Way { slab: 0, direction, flux: share, length_mm: 0.0, interfaces: 0, rough: 0 });
            while let Some(way) = ways.pop() {
                if let Some(way) = segments.cross_slab(stack, way, FAINT * share, &mut stream) {
                    meet_interface(stack, &way, ray, &mut stream, &mut ways);
                }
            }
        }
        segments
    }

    /// Segments by direction.
    pub fn rays(&self) -> impl Iterator<Item = Ray> + '_ {
        let cells = [true, false].into_iter().zip(&self.cells);
        let each = cells.flat_map(|(down, cells)| cells.iter().map(move |cell| (down, cell)));
        let some = each.filter(|(_, [flux, _])| *flux > 0.0);
        some.map(|(down, [flux, moment])| Ray { down, cosine: moment / flux, flux: *flux })
    }

    /// Mean cosine of what enters at the upper face; 1 if nothing does.
    pub fn mean_cosine(&self) -> f64 {
        let [flux, moment] = self.cells[0].iter().fold([0.0; 2], |[f, m], cell| [f + cell[0], m + cell[1]]);
        if flux > 0.0 { moment / flux } else { 1.0 }
    }

    /// Mean length in the sample of the light that comes to the base.
    pub fn base_length_mm(&self) -> f64 {
        if self.base > 0.0 { self.base_lengths / self.base } else { 0.0 }
    }

    /// Takes light to the end of its slab. None if it ends there.
    fn cross_slab(&mut self, stack: &Stack, mut way: Way, faint: f64, stream: &mut Stream) -> Option<Way> {
        let down = way.direction.z < 0.0;
        let cosine = f64::from(way.direction.z.abs());
        if way.slab == stack.sample {
            let cell = &mut self.cells[usize::from(!down)][((cosine * CELLS as f64) as usize).min(CELLS - 1)];
            cell[0] += way.flux;
            cell[1] += way.flux * cosine;
            let length_mm = f64::from(stack.thickness_mm[way.slab]) / cosine.max(1e-6);
            way.length_mm += length_mm;
            way.flux *= exp(-length_mm / f64::from(stack.mean_free_path_mm));
        }
        if way.flux < faint {
            if f64::from(uniform(stream.words()[0])) * faint >= way.flux {
                return None;
            }
            way.flux = faint;
        }
        if down && way.slab == stack.interfaces.len() {
            self.base += way.flux;
            self.base_lengths += way.flux * way.length_mm;
            return None;
        }
        Some(way)
    }
}

/// Sends light on from the interface at the end of its slab.
fn meet_interface(stack: &Stack, way: &Way, ray: u32, stream: &mut Stream, ways: &mut Vec<Way>) {
    let d = way.direction;
    let down = d.z < 0.0;
    let interface = stack.interfaces[if down { way.slab } else { way.slab - 1 }];
    let (above, below) = (interface.from_above, interface.from_below);
    let indices = if down { [above, below] } else { [below, above] };
    let (alpha, up) = (interface.alpha, if down { 1.0 } else { -1.0 });
    let wi = Vec3::new(-d.x, -d.y, -up * d.z);
    let mut go = |wo: Vec3, share: f64| {
        let slab = match (wo.z < 0.0, down) {
            (false, _) => way.slab,
            (true, true) => way.slab + 1,
            (true, false) => way.slab - 1,
        };
        if slab > 0 && share > 0.0 && way.interfaces < MOST_INTERFACES {
            let direction = Vec3::new(wo.x, wo.y, up * wo.z);
            let (flux, interfaces) = (way.flux * share, way.interfaces + 1);
            let rough = way.rough + u32::from(alpha > 0.0);
            ways.push(Way { slab, direction, flux, interfaces, rough, ..*way });
        }
    };
    if alpha > 0.0 && stack.multiple_scattering {
        go(scatter_until_out(wi, alpha, indices, stream).direction, 1.0);
        return;
    }
    let m = normal(wi, alpha, way.rough == 0, ray, stream);
    let cos_i = wi.dot(m);
    let facet = Facet::new(cos_i, indices[0]);
    let reflectance = if facet.cos_t <= 0.0 { 1.0 } else { f64::from(facet.reflectance()) };
    let kept = |wo: Vec3, cos: f32| match alpha {
        0.0 => 1.0,
        _ if cos > 0.0 => f64::from(masking(cos, wo.x * wo.x + wo.y * wo.y, alpha)),
        _ => 0.0,
    };
    let reflected = reflect(wi, m, cos_i);
    go(reflected, reflectance * kept(reflected, reflected.z));
    let refracted = refract(wi, m, cos_i, facet.cos_t, indices[0].eta);
    go(refracted, (1.0 - reflectance) * kept(refracted, -refracted.z));
}

/// A normal visible from `wi`.
fn normal(wi: Vec3, alpha: f32, first: bool, ray: u32, stream: &mut Stream) -> Vec3 {
    if alpha == 0.0 {
        return Vec3::Z;
    }
    if !first {
        let words = stream.words();
        return sample_visible_normal(wi, alpha, uniform(words[1]), words[2]);
    }
    // 1/g and 1/g², g³ = g + 1.
    let shifted = |step: f64| (0.5 + f64::from(ray) * step).fract();
    let (u, azimuth) = (shifted(0.754_877_666_246_692_7), shifted(0.569_840_290_998_053_2));
    sample_visible_normal(wi, alpha, u as f32, (65_536.0 * azimuth) as u32)
}

/// Exponential of a number that is not above 0, by operations that give the same bits on every machine; relative error
/// below 1e-14.
pub fn exp(x: f64) -> f64 {
    if x < -700.0 {
        return 0.0;
    }
    let n = (x * std::f64::consts::LOG2_E).round();
    // LN_2 in two parts, the first with trailing zeros, so that n times it is exact.
    let r = (x - n * 0.693_147_180_369_123_8) - n * 1.908_214_929_270_587_7e-10;
    let series = (1..=13).rev().fold(1.0, |p, k| 1.0 + p * r / f64::from(k));
    series * f64::from_bits(((n as i64 + 1023) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_is_accurate() {
        for i in 0..70_000 {
            let x = -0.01 * f64::from(i);
            assert!((exp(x) / x.exp() - 1.0).abs() < 1e-14, "{x}");
        }
        assert_eq!((exp(0.0), exp(-1e6)), (1.0, 0.0));
    }
}
