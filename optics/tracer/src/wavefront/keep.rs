//! Picks vertices of vectors of walks, see [`crate::pick`].

use fearless_simd::{Bytes, ExtractToken, Simd, SimdBase, SimdFloat, SimdInt, SimdInto, SimdMask, i32x16};

use super::bits;
use super::hits::Hits;
use super::lanes::{Floats, Mask, WalkLanes, Words};
use super::numbers::{Philox, choose, constant, power_of_two, uniform};
use super::table::LaneTable;
use crate::exits::Exits;
use crate::light::{CELLS, Light};
use crate::pick::{AT_BASE, PICK_BLOCK, Pick, STEP, cut, early};

/// The light, and the vertices that the walks of a chunk have picked.
#[derive(Debug)]
pub struct Keep<'a, S: Simd> {
    light: &'a Light,
    step: f32,
    down: LaneTable<S>,
    up: LaneTable<S>,
    pub exits: &'a mut Exits,
}

/// Points at which walks have met the light: their heights, and the cosines with which the walks arrived.
#[derive(Debug, Clone, Copy)]
struct Crossing<S: Simd> {
    z: Floats<S>,
    u: Floats<S>,
    worth: Floats<S>,
}

impl<'a, S: Simd> Keep<'a, S> {
    #[inline(always)]
    pub fn new(simd: S, light: &'a Light, exits: &'a mut Exits) -> Self {
        Self {
            light,
            step: STEP * light.measure,
            down: LaneTable::new(simd, &light.down),
            up: LaneTable::new(simd, &light.up),
            exits,
        }
    }

    /// The rest of the first step of walks.
    #[inline(always)]
    pub fn first_step(&self, simd: S, random: &Philox<S>, walk: Words<S>) -> Floats<S> {
        let [word, ..] = random.words(Words::splat(simd, PICK_BLOCK), walk);
        uniform(word) * self.step
    }

    /// [`Light::about`].
    #[inline(always)]
    fn about(&self, z: Floats<S>, u: Floats<S>) -> Floats<S> {
        let cell: i32x16<S> = ((u + 1.0) * (0.5 * CELLS as f32)).max(0.0).to_int();
        let cell: Words<S> = cell.min(CELLS as i32 - 1).bitcast();
        let height = z * self.light.fading;
        let down = self.down.at(cell) * power_of_two(height - self.light.faded);
        if self.light.thick { down } else { down + self.up.at(cell) * power_of_two(-height) }
    }

    /// [`crate::pick::importance`].
    #[inline(always)]
    fn importance(scatterings: Words<S>) -> Floats<S> {
        let [a, b] = early();
        let n: Floats<S> = scatterings.bitcast::<i32x16<S>>().to_float();
        (constant(n, a) - n * b).max(1.0)
    }

    /// Processes a scattering of the chosen walks, which arrived with the cosine `u`.
    #[inline(always)]
    pub fn scattered(&mut self, walks: &mut WalkLanes<S>, u: Floats<S>, lanes: Mask<S>, hits: &Hits) {
        let worth = self.about(walks.z, u) * Self::importance(walks.scatterings);
        self.add(walks, &Crossing { z: walks.z, u, worth }, lanes, hits);
    }

    /// Processes a hit of the chosen walks, which arrived with the cosine `u`, on the base.
    #[inline(always)]
    pub fn hit(&mut self, walks: &mut WalkLanes<S>, u: Floats<S>, lanes: Mask<S>, hits: &Hits) {
        let worth = constant(walks.z, self.light.base) * Self::importance(walks.scatterings);
        self.add(walks, &Crossing { z: constant(worth, AT_BASE), u, worth }, lanes, hits);
    }

    #[inline(always)]
    fn add(&mut self, walks: &mut WalkLanes<S>, place: &Crossing<S>, lanes: Mask<S>, hits: &Hits) {
        let worth = place.worth * walks.weight;
        walks.left -= choose(lanes, worth, constant(worth, 0.0));
        let picked = lanes & walks.left.simd_lt(0.0);
        if picked.any_true() {
            self.pick(walks, place, picked, hits);
        }
    }

    /// Picks vertices, one after the other: a walk does so a few times.
    #[inline(always)]
    fn pick(&mut self, walks: &mut WalkLanes<S>, place: &Crossing<S>, picked: Mask<S>, hits: &Hits) {
        let (z, u, worth) = (place.z.to_array(), place.u.to_array(), place.worth.to_array());
        let (walk, scatterings) = (walks.walk.to_array(), walks.scatterings.to_array());
        let (length, mut left) = (walks.length.to_array(), walks.left.to_array());
        for lane in bits(picked) {
            self.exits.pick(Pick {
                walk: walk[lane],
                z: z[lane],
                u: u[lane],
                worth: worth[lane],
                cuts: cut(&mut left[lane], self.step),
                scatterings: scatterings[lane],
                hits: hits.count(walk[lane]),
                length: length[lane],
            });
        }
        walks.left = left.simd_into(walks.x.token());
    }
}
