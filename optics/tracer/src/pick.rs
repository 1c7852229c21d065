//! One vertex of a walk for each group of albedos, chosen in proportion to what it is worth.
//!
//! A walk's vertex i, a scattering or a hit on the base after n_i scatterings, is worth c_i α^(n_i). Scored is one vertex
//! for each group of albedos: i with the probability c_i α_ref^(n_i)/S, S = Σ_j c_j α_ref^(n_j), and for every albedo of
//! the group S (α/α_ref)^(n_i).
//!
//! Vertices come one after the other. The one at hand takes the place of the one that is kept with the probability c
//! α_ref^n over the sum so far; so the next that does is the first at which the sum passes S/ξ, ξ being uniform and drawn
//! when the last one was kept (Efraimidis and Spirakis 2006, "Weighted random sampling with a reservoir", exponential
//! jumps).

use super::light::Light;
use super::rng::{Stream, uniform};

/// α_ref of each group, which holds the albedos up to it.
pub const REFERENCES: [f32; GROUPS] = [0.9, 1.0];
pub const GROUPS: usize = 2;

/// Powers of a reference below this are taken as 0: smaller floats are slow.
pub const SMALLEST_POWER: f32 = 1e-30;

/// Blocks of random numbers for choosing vertices have this bit, and the number of the vertex below it.
pub const PICK_BLOCKS: u32 = 1 << 31;

/// A vertex that is kept.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pick {
    /// Height and cosine of a scattering; a hit on the base has a height below 0.
    pub z_mm: f32,
    pub u: f32,
    /// What it was taken to be worth, and the walk's weight in that.
    pub worth: f32,
    pub weight: f32,
    pub scatterings: u32,
    /// Hits on the base so far.
    pub hits: u32,
    /// Length travelled in the sample so far.
    pub length_mm: f32,
}

/// Height of hits on the base.
pub const AT_BASE: f32 = -1.0;

/// Indices of the albedos of each group.
pub fn members(albedos: &[f64]) -> [Vec<usize>; GROUPS] {
    let mut members: [Vec<usize>; GROUPS] = Default::default();
    for (i, albedo) in albedos.iter().enumerate() {
        let group = REFERENCES.iter().position(|r| *albedo <= f64::from(*r) + 1e-6);
        members[group.unwrap_or(GROUPS - 1)].push(i);
    }
    members
}

impl Pick {
    /// By what the sum over a walk's vertices is to be multiplied, since this one was taken to be worth more or less than
    /// it is; and the length in the sample of the walk up to here and of the light that it is connected with.
    pub fn corrected(&self, light: &Light) -> (f64, f32) {
        let (exact, length_mm) = if self.z_mm < 0.0 { light.at_base() } else { light.at(self.z_mm, self.u) };
        (exact * f64::from(self.weight) / f64::from(self.worth), self.length_mm + length_mm)
    }
}

/// What a walk keeps, in the scalar kernel.
#[derive(Debug, Clone, Copy)]
pub struct Reservoir {
    /// S of each group, and where the next vertex is kept.
    sum: [f32; GROUPS],
    next: [f32; GROUPS],
    /// α_ref^n of the first group; that of the last is 1.
    power: f32,
    picks: [Pick; GROUPS],
}

impl Reservoir {
    pub fn new() -> Self {
        Self { sum: [0.0; GROUPS], next: [0.0; GROUPS], power: 1.0, picks: [Pick::default(); GROUPS] }
    }

    /// Another scattering.
    pub fn scattered(&mut self) {
        let power = self.power * REFERENCES[0];
        self.power = if power < SMALLEST_POWER { 0.0 } else { power };
    }

    /// Adds a vertex; `stream` is any of the walk's.
    pub fn add(&mut self, vertex: Pick, stream: &Stream) {
        let mut words = None;
        for (group, power) in [self.power, 1.0].into_iter().enumerate() {
            self.sum[group] += vertex.worth * power;
            if self.sum[group] > self.next[group] {
                let words = words.get_or_insert_with(|| vertex.words(stream));
                self.next[group] = self.sum[group] / uniform(words[group]);
                self.picks[group] = vertex;
            }
        }
    }

    /// Sum and vertex of each group that has one.
    pub fn kept(&self) -> impl Iterator<Item = (usize, f32, Pick)> {
        let all = self.sum.iter().zip(&self.picks).enumerate();
        all.filter(|(_, (sum, _))| **sum > 0.0).map(|(group, (sum, pick))| (group, *sum, *pick))
    }
}

impl Pick {
    /// The vertex's own random numbers.
    pub fn words(&self, stream: &Stream) -> [u32; 4] {
        stream.clone().at_block(PICK_BLOCKS | (self.scatterings + self.hits)).words()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn albedos_belong_to_the_group_with_the_next_larger_reference() {
        assert_eq!(members(&[0.05, 0.9, 0.91, 1.0]), [vec![0, 1], vec![2, 3]]);
        assert_eq!(members(&[0.95, 0.1, 0.99]), [vec![1], vec![0, 2]]);
    }

    /// Vertices are kept as often as they are worth, in each group by its own powers.
    #[test]
    fn vertices_are_kept_in_proportion_to_their_worth() {
        const WALKS: u32 = 200_000;
        let worths = [0.3_f32, 1.0, 0.01, 2.0, 0.7];
        let mut counts = [[0_u64; 5]; GROUPS];
        for walk in 0..WALKS {
            let stream = Stream::new([17, 4], 1, walk);
            let mut reservoir = Reservoir::new();
            for (n, worth) in (1..).zip(worths) {
                reservoir.scattered();
                reservoir.add(Pick { worth, scatterings: n, ..Pick::default() }, &stream);
            }
            for (group, _, pick) in reservoir.kept() {
                counts[group][pick.scatterings as usize - 1] += 1;
            }
        }
        for (group, counts) in counts.iter().enumerate() {
            let worth = |i: usize| f64::from(worths[i]) * f64::from(REFERENCES[group]).powi(i as i32);
            let total: f64 = (0..5).map(worth).sum();
            let shares: Vec<f64> = (0..5).map(|i| worth(i) / total).collect();
            let p = crate::testing::chi_square(counts, &shares);
            assert!(p > 1e-4, "group {group}: {counts:?}, p = {p}");
        }
    }
}
