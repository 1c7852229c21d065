//! What walks keep of their vertices, see [`crate::pick`].

use fearless_simd::{Bytes, ExtractToken, Simd, SimdBase, SimdFloat, SimdInt, SimdInto, SimdMask, i32x16};

use super::bits;
use super::hits::Hits;
use super::lanes::{Floats, Mask, Walks, Words};
use super::numbers::{choose, constant, power_of_two};
use super::table::Table;
use crate::exits::Chunk;
use crate::light::{Light, NODES};
use crate::pick::{AT_BASE, GROUPS, Pick, REFERENCES, SMALLEST_POWER};
use crate::rng::{Stream, uniform};

/// The light, and the vertices that the walks of a chunk have kept.
#[derive(Debug)]
pub struct Keep<'a, S: Simd> {
    pub light: &'a Light,
    chunk: Chunk,
    down: [Table<S>; 2],
    up: [Table<S>; 2],
    /// By walk.
    picks: Vec<[Pick; GROUPS]>,
}

/// Where walks have met the light: their heights and the cosines with which they came.
#[derive(Debug, Clone, Copy)]
struct Place<S: Simd> {
    z: Floats<S>,
    u: Floats<S>,
    worth: Floats<S>,
}

impl<'a, S: Simd> Keep<'a, S> {
    #[inline(always)]
    pub fn new(simd: S, light: &'a Light, chunk: Chunk) -> Self {
        let [down, steps_down] = &light.down;
        let [up, steps_up] = &light.up;
        Self {
            light,
            chunk,
            down: [Table::new(simd, down), Table::new(simd, steps_down)],
            up: [Table::new(simd, up), Table::new(simd, steps_up)],
            picks: vec![[Pick::default(); GROUPS]; chunk.walks as usize],
        }
    }

    /// [`Light::about`].
    #[inline(always)]
    fn about(&self, z: Floats<S>, u: Floats<S>) -> Floats<S> {
        let x = ((u + 1.0) * (0.5 * (NODES - 1) as f32)).max(0.0).min((NODES - 1) as f32 - 0.001);
        let node: i32x16<S> = x.to_int();
        let beyond = x - node.to_float::<Floats<S>>();
        let node: Words<S> = node.bitcast::<Words<S>>() & (NODES - 1) as u32;
        let down = self.down[0].at(node) + self.down[1].at(node) * beyond;
        let up = self.up[0].at(node) + self.up[1].at(node) * beyond;
        let height = z * self.light.fading;
        down * power_of_two(height - self.light.faded) + up * power_of_two(-height)
    }

    /// The chosen walks, which came with the cosine `u`, have scattered.
    #[inline(always)]
    pub fn scattered(&mut self, walks: &mut Walks<S>, u: Floats<S>, lanes: Mask<S>, hits: &Hits) {
        let power = walks.power * REFERENCES[0];
        let power = choose(power.simd_lt(SMALLEST_POWER), constant(power, 0.0), power);
        walks.power = choose(lanes, power, walks.power);
        let worth = self.about(walks.z, u) * walks.weight;
        self.add(walks, &Place { z: walks.z, u, worth }, lanes, hits);
    }

    /// The chosen walks have hit the base.
    #[inline(always)]
    pub fn hit(&mut self, walks: &mut Walks<S>, lanes: Mask<S>, hits: &Hits) {
        let worth = walks.weight * self.light.base;
        self.add(walks, &Place { z: constant(worth, AT_BASE), u: walks.dz, worth }, lanes, hits);
    }

    #[inline(always)]
    fn add(&mut self, walks: &mut Walks<S>, place: &Place<S>, lanes: Mask<S>, hits: &Hits) {
        let worth = choose(lanes, place.worth, constant(place.worth, 0.0));
        walks.sums[0] += worth * walks.power;
        walks.sums[1] += worth;
        let kept = [0, 1].map(|g| lanes & walks.sums[g].simd_gt(walks.next[g]));
        if (kept[0] | kept[1]).any_true() {
            self.keep(walks, place, kept, hits);
        }
    }

    /// Keeps vertices, one after the other: a walk does so a few times.
    #[inline(always)]
    fn keep(&mut self, walks: &mut Walks<S>, place: &Place<S>, kept: [Mask<S>; GROUPS], hits: &Hits) {
        let (z, u, worth) = (place.z.to_array(), place.u.to_array(), place.worth.to_array());
        let (walk, scatterings) = (walks.walk.to_array(), walks.scatterings.to_array());
        let (weight, length) = (walks.weight.to_array(), walks.length.to_array());
        let sums = walks.sums.map(|s| s.to_array());
        let mut next = walks.next.map(|n| n.to_array());
        let groups = kept.map(|k| k.to_bitmask());
        for lane in bits(kept[0] | kept[1]) {
            let vertex = Pick {
                z_mm: z[lane],
                u: u[lane],
                worth: worth[lane],
                weight: weight[lane],
                scatterings: scatterings[lane],
                hits: hits.count(walk[lane]),
                length_mm: length[lane],
            };
            let words = vertex.words(&Stream::new(self.chunk.key, self.chunk.index, walk[lane]));
            for g in 0..GROUPS {
                if groups[g] >> lane & 1 == 1 {
                    next[g][lane] = sums[g][lane] / uniform(words[g]);
                    self.picks[walk[lane] as usize][g] = vertex;
                }
            }
        }
        let simd = walks.x.token();
        walks.next = next.map(|n| n.simd_into(simd));
    }

    /// What a walk has kept in each group, whose sums these are.
    pub fn kept(&self, walk: u32, sums: [f32; GROUPS]) -> impl Iterator<Item = (usize, f32, Pick)> {
        let all = sums.into_iter().zip(self.picks[walk as usize]).enumerate();
        all.filter(|(_, (sum, _))| *sum > 0.0).map(|(group, (sum, pick))| (group, sum, pick))
    }
}
