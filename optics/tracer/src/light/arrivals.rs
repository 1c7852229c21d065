//! Follows light that meets interfaces only: from the ring to the sample and to the base, and from the sensor straight
//! back into the ring.
//!
//! It depends on the medium through the transmittance of the sample alone, e^(−τ L), L being the length in the sample in
//! thicknesses. So it is followed once for a stack of interfaces and represented by beams: light of nearly one direction
//! that has passed nearly the same length. Their attenuation follows for every medium.
//!
//! At every interface light is reflected and refracted, with the shares of Fresnel's formulas; faint light is subject to
//! Russian roulette. The ring's angles and the first three rough faces' normals come from a Kronecker sequence (Roberts
//! 2018, "The unreasonable effectiveness of quasirandom sequences"), others from streams with a key of their own. Rays
//! carry flux, and the interfaces are reciprocal, so that each is crossed as walks cross it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use glam::Vec3;
use optics_model::phase::PhaseFunction;

use crate::fresnel::{Facet, reflect, refract};
use crate::math::exp_f64;
use crate::microfacet::{masking, sample_visible_normal, split_until_out};
use crate::rng::{Stream, uniform};
use crate::stack::Stack;

/// Cells of the cosine into which beams are gathered.
const CELLS: usize = 128;
/// Neighbouring cells that are merged where they hold less than one part in `BEAMS` of all light.
const NEAR: usize = 16;
const BEAMS: f64 = 512.0;
/// Width of the phase function's peak from which it does not distinguish the directions in merged cells: of other
/// functions, and of a single lobe.
const WIDE: [f64; 2] = [0.5, 0.25];
/// Passes through the sample that beams distinguish; the last two represent all later ones, too. Where rough faces lose
/// no light, some of it passes at grazing angles, and a mean length would represent lengths that differ too much. There
/// beams distinguish lengths: none, four to an octave up to 64 thicknesses, and beyond.
const PASSES: usize = 4;
const LENGTHS: usize = 26;
/// Number of rays where all interfaces are smooth, and where some are rough.
const RAYS: [u32; 2] = [256, 1 << 15];
/// Share of a ray's flux below which Russian roulette decides whether it is continued.
const FAINT: f64 = 2e-3;
/// Interfaces after which light is discarded. Only a ray that rounding has trapped between two faces that reflect totally
/// meets this many.
const MOST_INTERFACES: u32 = 1000;
/// Steps of the sequence at the first three rough faces: g⁻¹ … g⁻⁶, g⁷ = g + 1.
const STEPS: [[f64; 2]; 3] = [
    [0.898_653_712_628_699_2, 0.807_578_495_221_344_7],
    [0.725_733_412_969_759_7, 0.652_183_025_943_971_5],
    [0.586_086_697_577_969_3, 0.526_688_986_700_735_7],
];
/// Keys of the streams from the ring, and from the sensor.
const KEYS: [[u32; 2]; 2] = [[0x9d1f_3c55, 0x27d4_eb2f], [0x4b7a_91d3, 0x6c8e_52a7]];
/// Stacks whose arrivals are cached: more than the scene `lab` has with its variants.
const REMEMBERED: usize = 32;

/// Light of about one direction that has passed about the same length of the sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beam {
    /// Whether it goes down.
    pub down: bool,
    /// Mean |cos θ| in the sample.
    pub cosine: f64,
    /// Share of the light that was sent out, as if the sample were clear.
    pub flux: f64,
    /// Mean length passed in the sample before, in thicknesses.
    pub passed: f64,
}

/// Arrivals of light that meets interfaces only.
#[derive(Debug, Default)]
pub struct Arrivals {
    /// From the ring, where it enters the sample or is reflected in it.
    pub sample: Vec<Beam>,
    /// From the ring, where it meets the base.
    pub base: Vec<Beam>,
    /// From the sensor, where it leaves into the ring.
    pub ring: Vec<Beam>,
}

impl Arrivals {
    /// The arrivals of a stack; those of the last few stacks are cached.
    pub fn of(stack: &Stack) -> Arc<Self> {
        static KNOWN: Mutex<VecDeque<(Vec<u64>, Arc<Arrivals>)>> = Mutex::new(VecDeque::new());
        let key = key_of(stack);
        // The lock is held during the computation, so that it is done once.
        let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, arrivals)) = known.iter().find(|(of, _)| *of == key) {
            return Arc::clone(arrivals);
        }
        let rough = stack.interfaces.iter().any(|i| i.alpha > 0.0);
        let arrivals = Arc::new(Self::follow(stack, RAYS[usize::from(rough)], 0));
        known.truncate(REMEMBERED - 1);
        known.push_front((key, Arc::clone(&arrivals)));
        arrivals
    }

    /// Repeats differ in their random numbers only.
    fn follow(stack: &Stack, rays: u32, repeat: u32) -> Self {
        let [inner, outer] = stack.ring_sin2.map(|s| f64::from(s).clamp(0.0, 1.0));
        let share = 1.0 / f64::from(rays);
        let mut from_ring = RaySums::default();
        for ray in 0..rays {
            let sin2 = inner + (outer - inner) * (f64::from(ray) + 0.5) * share;
            let direction = Vec3::new(sin2.sqrt() as f32, 0.0, -((1.0 - sin2).sqrt() as f32));
            let number = ray + repeat * rays;
            from_ring.follow(stack, direction, number, share, &mut Stream::new(KEYS[0], 0, number));
        }
        let mut from_sensor = RaySums::default();
        for ray in 0..rays {
            let number = ray + repeat * rays;
            let stream = &mut Stream::new(KEYS[1], 0, number);
            from_sensor.follow(stack, stack.sensor_direction, number, share, stream);
        }
        Self {
            sample: from_ring.sample.beams(),
            base: from_ring.base.beams(),
            ring: from_sensor.ring.beams(),
        }
    }
}

impl Arrivals {
    /// Beams in a sample of this optical thickness: they are attenuated over the length that they have passed, and beams
    /// of nearly one direction are merged, unless the phase function is narrow enough to distinguish them. Their `passed`
    /// is a mean.
    pub fn in_sample(&self, optical_thickness: f64, phase: &PhaseFunction) -> Vec<Beam> {
        let mut cells = vec![[0.0; 3]; 2 * CELLS];
        for beam in &self.sample {
            let flux = beam.flux * exp_f64(-optical_thickness * beam.passed);
            let cell = ((beam.cosine * CELLS as f64) as usize).min(CELLS - 1);
            let sums = &mut cells[usize::from(beam.down) * CELLS + cell];
            for (sum, factor) in sums.iter_mut().zip([1.0, beam.cosine, beam.passed]) {
                *sum += flux * factor;
            }
        }
        let is_narrow = phase.peak_width() < WIDE[usize::from(phase.is_single_lobe())];
        let faint = if is_narrow { 0.0 } else { cells.iter().map(|[flux, ..]| flux).sum::<f64>() / BEAMS };
        let mut beams = Vec::new();
        for (side, cells) in cells.chunks_exact(CELLS).enumerate() {
            for near in cells.chunks_exact(NEAR) {
                // Faint cells are merged, each of the others makes a beam.
                let mut rest = [0.0; 3];
                for cell in near {
                    if cell[0] > faint {
                        beams.push(beam(side == 1, *cell));
                    } else {
                        rest.iter_mut().zip(cell).for_each(|(rest, sum)| *rest += sum);
                    }
                }
                if rest[0] > 0.0 {
                    beams.push(beam(side == 1, rest));
                }
            }
        }
        beams
    }
}

fn beam(down: bool, [flux, cosines, lengths]: [f64; 3]) -> Beam {
    Beam { down, cosine: cosines / flux, flux, passed: lengths / flux }
}

/// All properties of a stack that light which meets interfaces only depends on.
fn key_of(stack: &Stack) -> Vec<u64> {
    let d = stack.sensor_direction;
    let floats = [stack.ring_sin2[0], stack.ring_sin2[1], d.x, d.y, d.z];
    let interfaces = stack.interfaces.iter().map(|i| u64::from(i.alpha.to_bits()));
    let complements =
        stack.interfaces.iter().flat_map(|i| [i.from_above.complement, i.from_below.complement]);
    let mut key = vec![stack.sample as u64, u64::from(stack.multiple_scattering)];
    key.extend(stack.iors.iter().map(|ior| ior.to_bits()));
    key.extend(interfaces);
    key.extend(floats.into_iter().chain(complements).map(|f| u64::from(f.to_bits())));
    key
}

/// Flux by direction, cosine and passes, with the sums of flux times cosine and of flux times length.
#[derive(Debug)]
struct DirectionCells(Vec<[f64; 3]>);

impl Default for DirectionCells {
    fn default() -> Self {
        Self(vec![[0.0; 3]; 2 * LENGTHS * CELLS])
    }
}

impl DirectionCells {
    fn add(&mut self, way: &LightPath, cosine: f64, by_length: bool) {
        let cell = ((cosine * CELLS as f64) as usize).min(CELLS - 1);
        let length = match way.passes {
            0 => 0,
            // The exponent, and two bits behind it.
            _ if by_length => (1
                + ((way.passed as f32).to_bits().saturating_sub(1_f32.to_bits()) >> 21) as usize)
                .min(LENGTHS - 1),
            // Even and odd numbers apart: they have come from different sides.
            passes if passes >= PASSES => PASSES - 2 + passes % 2,
            passes => passes,
        };
        let down = usize::from(way.direction.z < 0.0);
        let sums = &mut self.0[(down * LENGTHS + length) * CELLS + cell];
        for (sum, factor) in sums.iter_mut().zip([1.0, cosine, way.passed]) {
            *sum += way.flux * factor;
        }
    }

    fn beams(self) -> Vec<Beam> {
        let some = self.0.into_iter().enumerate().filter(|(_, [flux, ..])| *flux > 0.0);
        some.map(|(cell, sums)| beam(cell >= LENGTHS * CELLS, sums)).collect()
    }
}

/// Sums over rays.
#[derive(Debug, Default)]
struct RaySums {
    sample: DirectionCells,
    base: DirectionCells,
    ring: DirectionCells,
}

/// Light on its way, at the beginning of a slab.
struct LightPath {
    slab: usize,
    direction: Vec3,
    flux: f64,
    /// Length in the sample so far, in thicknesses, the number of passes, and the last one's cosine.
    passed: f64,
    passes: usize,
    cosine: f64,
    /// Interfaces met so far, and rough ones.
    interfaces: u32,
    rough: u32,
}

impl RaySums {
    fn follow(&mut self, stack: &Stack, direction: Vec3, ray: u32, flux: f64, stream: &mut Stream) {
        let mut ways = vec![LightPath {
            slab: 0,
            direction,
            flux,
            passed: 0.0,
            passes: 0,
            cosine: 1.0,
            interfaces: 0,
            rough: 0,
        }];
        while let Some(way) = ways.pop() {
            if let Some(way) = self.cross_slab(stack, way, FAINT * flux, stream) {
                meet_interface(stack, &way, ray, FAINT * flux, stream, &mut ways);
            }
        }
    }

    /// Takes light to the end of its slab. None if it ends there.
    fn cross_slab(
        &mut self,
        stack: &Stack,
        mut way: LightPath,
        faint: f64,
        stream: &mut Stream,
    ) -> Option<LightPath> {
        let down = way.direction.z < 0.0;
        if way.slab == 0 && !down {
            let d = way.direction;
            let [inner, outer] = stack.ring_sin2;
            if (inner..=outer).contains(&(d.x * d.x + d.y * d.y)) {
                self.ring.add(&way, way.cosine, stack.multiple_scattering);
            }
            return None;
        }
        if way.slab == stack.sample {
            way.cosine = f64::from(way.direction.z.abs()).max(1e-6);
            self.sample.add(&way, way.cosine, stack.multiple_scattering);
            way.passed += 1.0 / way.cosine;
            way.passes += 1;
        }
        if down && way.slab == stack.interfaces.len() {
            self.base.add(&way, way.cosine, stack.multiple_scattering);
            return None;
        }
        if way.flux < faint {
            if f64::from(uniform(stream.words()[0])) * faint >= way.flux {
                return None;
            }
            way.flux = faint;
        }
        Some(way)
    }
}

/// Sends light on from the interface at the end of its slab.
fn meet_interface(
    stack: &Stack,
    way: &LightPath,
    ray: u32,
    faint: f64,
    stream: &mut Stream,
    ways: &mut Vec<LightPath>,
) {
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
        if share > 0.0 && way.interfaces < MOST_INTERFACES {
            let direction = Vec3::new(wo.x, wo.y, up * wo.z);
            let (flux, interfaces) = (way.flux * share, way.interfaces + 1);
            let rough = way.rough + u32::from(alpha > 0.0);
            ways.push(LightPath { slab, direction, flux, interfaces, rough, ..*way });
        }
    };
    let m = normal(wi, alpha, way.rough, ray, stream);
    if alpha > 0.0 && stack.multiple_scattering {
        for (wo, share) in split_until_out(wi, m, alpha, indices, faint / way.flux, stream) {
            go(wo, share);
        }
        return;
    }
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

/// A normal visible from `wi` at the given rough face of the path.
fn normal(wi: Vec3, alpha: f32, rough: u32, ray: u32, stream: &mut Stream) -> Vec3 {
    if alpha == 0.0 {
        return Vec3::Z;
    }
    let Some([first, second]) = STEPS.get(rough as usize) else {
        let words = stream.words();
        return sample_visible_normal(wi, alpha, uniform(words[1]), words[2]);
    };
    let shifted = |step: f64| (0.5 + f64::from(ray) * step).fract();
    sample_visible_normal(wi, alpha, shifted(*first) as f32, (65_536.0 * shifted(*second)) as u32)
}

#[cfg(test)]
mod tests;
