//! Looks up tables of sixteen numbers in all lanes at once.

use fearless_simd::{Bytes, Select, Simd, SimdBase, SimdCombine, SimdSplit, u32x8, u32x16};

use super::permute::{permute8, permute16};
use super::vector::{Floats, WIDTH, Words};

#[derive(Debug, Clone, Copy)]
pub struct LaneTable<S: Simd> {
    whole: Words<S>,
    halves: [u32x8<S>; 2],
}

impl<S: Simd> LaneTable<S> {
    #[inline(always)]
    pub fn new(simd: S, values: &[f32; WIDTH]) -> Self {
        let bits = values.map(f32::to_bits);
        let half = |i: usize| u32x8::from_slice(simd, &bits[8 * i..8 * i + 8]);
        Self { whole: u32x16::from_slice(simd, &bits), halves: [half(0), half(1)] }
    }

    /// The values at these places, 0 to 15.
    #[inline(always)]
    pub fn at(&self, places: Words<S>) -> Floats<S> {
        if S::u32s::LEN == WIDTH / 2 {
            let (low, high) = places.split();
            return self.half(low).combine(self.half(high)).bitcast();
        }
        permute16(self.whole, places).bitcast()
    }

    #[inline(always)]
    fn half(&self, places: u32x8<S>) -> u32x8<S> {
        let beyond = places.simd_gt(7);
        beyond.select(permute8(self.halves[1], places), permute8(self.halves[0], places))
    }
}
