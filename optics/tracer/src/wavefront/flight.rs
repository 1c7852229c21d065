//! Runs flights in the sample: two per block of random numbers, each to a scattering or to a face.

use fearless_simd::{Bytes, Simd, SimdBase, SimdMask, i32x16};

use super::hits::Hits;
use super::keep::Keep;
use super::lanes::{Mask, WalkLanes, Words};
use super::numbers::{Philox, choose, constant, ln, uniform};
use crate::phase::PhaseSampler;
use crate::stack::Stack;

/// The properties of the sample that flights depend on.
#[derive(Debug, Clone, Copy)]
pub struct FlightSample<'a> {
    /// In mean free paths.
    thickness: f32,
    phase: &'a PhaseSampler,
}

impl<'a> FlightSample<'a> {
    pub fn new(stack: &'a Stack) -> Self {
        Self { thickness: stack.thickness[stack.sample], phase: &stack.phase }
    }

    /// Two flights of the chosen lanes. A walk that would pass a face stays where the flight began; returned are the
    /// lanes that have scattered twice.
    #[inline(always)]
    pub fn fly_twice<S: Simd>(
        &self,
        random: &Philox<S>,
        walks: &mut WalkLanes<S>,
        lanes: Mask<S>,
        keep: &mut Keep<'_, S>,
        hits: &Hits,
    ) -> Mask<S> {
        let [path, angles, next_path, next_angles] = random.words(walks.block, walks.walk);
        walks.block += 1;
        let u = walks.dz;
        let inside = self.fly(walks, lanes, path, angles);
        keep.scattered(walks, u, inside, hits);
        let u = walks.dz;
        let inside = self.fly(walks, inside, next_path, next_angles);
        keep.scattered(walks, u, inside, hits);
        inside
    }

    #[inline(always)]
    fn fly<S: Simd>(
        &self,
        walks: &mut WalkLanes<S>,
        lanes: Mask<S>,
        path: Words<S>,
        angles: Words<S>,
    ) -> Mask<S> {
        let free = -ln(uniform(path));
        let z = walks.z + walks.dz * free;
        let down = walks.dz.simd_lt(0.0);
        let up = walks.dz.simd_gt(0.0);
        let reaches_face = (down & z.simd_le(0.0)) | (up & z.simd_ge(self.thickness));
        let scatters = lanes & !reaches_face;
        let free = choose(scatters, free, constant(free, 0.0));
        walks.z = choose(scatters, z, walks.z);
        walks.x += walks.dx * free;
        walks.length += free;
        // A true lane is −1.
        let minus_one: i32x16<S> = scatters.to_vector();
        walks.scatterings -= minus_one.bitcast::<Words<S>>();
        let [dx, dy, dz] = self.phase.scatter([walks.dx, walks.dy, walks.dz], angles);
        walks.dx = choose(scatters, dx, walks.dx);
        walks.dy = choose(scatters, dy, walks.dy);
        walks.dz = choose(scatters, dz, walks.dz);
        scatters
    }
}
