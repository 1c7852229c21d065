//! The elementary functions and random numbers of [`crate::math`] and [`crate::rng`], for vectors: the
//! same operations in the same order, lane by lane.

use std::f32::consts::{LN_2, SQRT_2};

use fearless_simd::{Bytes, ExtractToken, Select, Simd, SimdBase, SimdFloat, SimdInt, i32x16, u64x8};

use super::lanes::{Floats, Mask, WIDTH, Words};
use crate::exits::Chunk;
use crate::math::{COS_PI, LN, SIN_PI};
use crate::phase::{Lanes, QUANTILES};
use crate::rng::{MULTIPLIERS, ROUNDS, WEYL};

/// Blocks of random numbers for the walks of a chunk.
#[derive(Debug, Clone, Copy)]
pub struct Philox<S: Simd> {
    chunk: [u64x8<S>; 2],
    /// The key of every round, in all lanes: an operand straight from memory.
    keys: [[u64x8<S>; 2]; ROUNDS as usize],
}

impl<S: Simd> Philox<S> {
    #[inline(always)]
    pub fn new(simd: S, chunk: Chunk) -> Self {
        let splat = |word: u64| u64x8::splat(simd, word);
        let mut key = chunk.key;
        let mut keys = [[splat(0); 2]; ROUNDS as usize];
        for round in &mut keys {
            *round = [splat(u64::from(key[0])), splat(u64::from(key[1]))];
            key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
        }
        Self { chunk: [splat(chunk.index & 0xffff_ffff), splat(chunk.index >> 32)], keys }
    }

    /// The given block of each walk.
    #[inline(always)]
    pub fn words(&self, block: Words<S>, walk: Words<S>) -> [Words<S>; 4] {
        let (block, walk): (u64x8<S>, u64x8<S>) = (block.bitcast(), walk.bitcast());
        let low = u64x8::splat(block.token(), 0xffff_ffff);
        let [e0, e1, e2, e3] = self.rounds(block & low, walk & low);
        let [o0, o1, o2, o3] = self.rounds(block >> 32, walk >> 32);
        // Written out: `array::from_fn` is not inlined into code for other instruction sets.
        [
            ((e0 & low) | (o0 << 32)).bitcast(),
            ((e1 & low) | (o1 << 32)).bitcast(),
            ((e2 & low) | (o2 << 32)).bitcast(),
            ((e3 & low) | (o3 << 32)).bitcast(),
        ]
    }

    /// Ten rounds with one walk per 64-bit lane, whose upper half is garbage in between.
    #[inline(always)]
    fn rounds(&self, block: u64x8<S>, walk: u64x8<S>) -> [u64x8<S>; 4] {
        let c = [block, walk, self.chunk[0], self.chunk[1]];
        // Written out as well: a loop would move words about between its iterations.
        let c = self.round(self.round(c, 0), 1);
        let c = self.round(self.round(c, 2), 3);
        let c = self.round(self.round(c, 4), 5);
        let c = self.round(self.round(c, 6), 7);
        self.round(self.round(c, 8), 9)
    }

    #[inline(always)]
    fn round(&self, [c0, c1, c2, c3]: [u64x8<S>; 4], round: usize) -> [u64x8<S>; 4] {
        // Constants here and not in `self`: the compiler must recognise that a product of 32-bit numbers suffices.
        let splat = |word: u32| u64x8::splat(c0.token(), u64::from(word));
        let [k0, k1] = self.keys[round];
        let a = (c0 & splat(u32::MAX)) * splat(MULTIPLIERS[0]);
        let b = (c2 & splat(u32::MAX)) * splat(MULTIPLIERS[1]);
        [(b >> 32) ^ c1 ^ k0, b, (a >> 32) ^ c3 ^ k1, a]
    }
}

#[inline(always)]
fn from_bits<S: Simd>(bits: Words<S>) -> Floats<S> {
    bits.bitcast()
}

/// Uniform in (0, 1).
#[inline(always)]
pub fn uniform<S: Simd>(bits: Words<S>) -> Floats<S> {
    from_bits(bits >> 9 | 0x3f80_0000) - (1.0 - 1.0 / 16_777_216.0)
}

/// [`crate::microfacet::level`].
#[inline(always)]
pub fn level<S: Simd>(bits: Words<S>) -> Floats<S> {
    from_bits((bits >> 9 & 0x007f_ff80) | 0x3f80_0000) - (1.0 - 1.0 / 131_072.0)
}

/// (cos φ, sin φ), from the lower 16 bits.
#[inline(always)]
pub fn unit_vector<S: Simd>(bits: Words<S>) -> (Floats<S>, Floats<S>) {
    let v = from_bits((bits << 8 & 0x007f_ff00) | 0x3f80_0000) - (1.5 - 1.0 / 65_536.0);
    let z = v * v;
    let [s0, s1, s2, s3, s4] = SIN_PI;
    let s = ((((z * s4 + s3) * z + s2) * z + s1) * z + s0) * v;
    let [c0, c1, c2, c3] = COS_PI;
    let c = (((z * c3 + c2) * z + c1) * z + c0) * z + 1.0;
    let turn = (bits & 0x8000) << 16;
    (flip_bits(c, turn), flip_bits(s, turn))
}

#[inline(always)]
fn flip_bits<S: Simd>(value: Floats<S>, sign: Words<S>) -> Floats<S> {
    from_bits(value.bitcast::<Words<S>>() ^ sign)
}

impl<S: Simd> Lanes for Floats<S> {
    type Bits = Words<S>;

    #[inline(always)]
    fn symmetric(bits: Words<S>) -> Self {
        from_bits((bits >> 9 & 0x007f_ff80) | 0x4000_0000) - (3.0 - 1.0 / 65_536.0)
    }

    #[inline(always)]
    fn unit_vector(bits: Words<S>) -> (Self, Self) {
        unit_vector(bits)
    }

    #[inline(always)]
    fn constant(self, value: f32) -> Self {
        constant(self, value)
    }

    #[inline(always)]
    fn magnitude(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn root(self) -> Self {
        root(self)
    }

    #[inline(always)]
    fn flip(self, by: Self) -> Self {
        flip_bits(self, by.bitcast::<Words<S>>() & 0x8000_0000)
    }

    #[inline(always)]
    fn below(self, limit: f32, [below, beyond]: [f32; 2]) -> Self {
        choose(self.simd_lt(limit), constant(self, below), constant(self, beyond))
    }

    #[inline(always)]
    fn look_up(table: &[f32; QUANTILES], bits: Words<S>) -> Self {
        let mut cosines = [0.0; WIDTH];
        let places: [u32; WIDTH] = (bits >> 16).into();
        for (cosine, place) in cosines.iter_mut().zip(places) {
            *cosine = table[place as usize];
        }
        Self::from_slice(bits.token(), &cosines)
    }
}

/// Natural logarithm of a positive normal number.
#[inline(always)]
pub fn ln<S: Simd>(x: Floats<S>) -> Floats<S> {
    let simd = x.token();
    let bits: i32x16<S> = x.bitcast();
    let e = (bits - i32x16::splat(simd, (SQRT_2 / 2.0).to_bits() as i32)) >> 23;
    let m: Floats<S> = (bits - (e << 23)).bitcast();
    let f = m - 1.0;
    let mut p = Floats::splat(simd, LN[0]);
    for c in &LN[1..] {
        p = p * f + *c;
    }
    let ff = f * f;
    e.to_float::<Floats<S>>() * LN_2 + (f + (ff * f * p - ff * 0.5))
}

/// [`crate::math::power_of_two`].
#[inline(always)]
pub fn power_of_two<S: Simd>(x: Floats<S>) -> Floats<S> {
    let bits: i32x16<S> = ((x.max(-100.0) + 127.0) * 8_388_608.0).to_int();
    from_bits(bits.bitcast())
}

/// [`crate::microfacet::minus_ln_at_most`].
#[inline(always)]
pub fn minus_ln_at_most<S: Simd>(x: Floats<S>) -> Floats<S> {
    let bits: i32x16<S> = x.bitcast();
    let below_one = i32x16::splat(x.token(), 0x3f80_0000) - bits;
    below_one.to_float::<Floats<S>>() * (LN_2 / 8_388_608.0)
}

/// A value in all lanes.
#[inline(always)]
pub fn constant<S: Simd>(like: Floats<S>, value: f32) -> Floats<S> {
    Floats::splat(like.token(), value)
}

/// √max(x, 0).
#[inline(always)]
pub fn root<S: Simd>(x: Floats<S>) -> Floats<S> {
    x.max(0.0).sqrt()
}

/// `a` where the lane is chosen, `b` elsewhere.
#[inline(always)]
pub fn choose<S: Simd>(lanes: Mask<S>, a: Floats<S>, b: Floats<S>) -> Floats<S> {
    lanes.select(a, b)
}
