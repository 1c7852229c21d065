//! Counter-based random numbers: Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy
//! as 1, 2, 3").
//!
//! A number is a pure function of (key, chunk, walk, block): it does not depend on the machine, thread or attempt that
//! requests it.

pub const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
pub const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];
pub const ROUNDS: u32 = 10;

/// Ten rounds of Philox4x32 on a counter.
pub fn philox4x32(counter: [u32; 4], key: [u32; 2]) -> [u32; 4] {
    let [mut c0, mut c1, mut c2, mut c3] = counter;
    let [mut k0, mut k1] = key;
    for _ in 0..ROUNDS {
        let a = u64::from(MULTIPLIERS[0]) * u64::from(c0);
        let b = u64::from(MULTIPLIERS[1]) * u64::from(c2);
        (c0, c1, c2, c3) = ((b >> 32) as u32 ^ c1 ^ k0, b as u32, (a >> 32) as u32 ^ c3 ^ k1, a as u32);
        k0 = k0.wrapping_add(WEYL[0]);
        k1 = k1.wrapping_add(WEYL[1]);
    }
    [c0, c1, c2, c3]
}

/// Uniform number from 32 random bits: the midpoint of one of 2²³ equal cells of (0, 1), never 0 or 1.
pub fn uniform(bits: u32) -> f32 {
    // The bits are the mantissa of 1 + k/2²³; the difference is exact.
    f32::from_bits(bits >> 9 | 0x3f80_0000) - (1.0 - 1.0 / 16_777_216.0)
}

/// Uniform number from the upper 16 random bits: the midpoint of one of 2¹⁶ equal cells of (−1, 1).
///
/// Fine enough for angles, whose distributions are smooth: the error of a mean is of the order of 2⁻³².
pub fn symmetric(bits: u32) -> f32 {
    f32::from_bits((bits >> 9 & 0x007f_ff80) | 0x4000_0000) - (3.0 - 1.0 / 65_536.0)
}

/// Number of a stream's first block: not 0, since walks play roulette at the multiples of a number.
pub const FIRST_BLOCK: u32 = 1;

/// The random numbers of one walk, in blocks of four words.
#[derive(Debug, Clone)]
pub struct Stream {
    key: [u32; 2],
    counter: [u32; 4],
}

impl Stream {
    /// `key` stands for seed and transport point, see `optics_model::identity::stream_key`; `walk` counts the walks
    /// of a chunk.
    pub fn new(key: [u32; 2], chunk: u64, walk: u32) -> Self {
        Self { key, counter: [FIRST_BLOCK, walk, chunk as u32, (chunk >> 32) as u32] }
    }

    /// This stream from a later block on.
    pub fn at_block(mut self, block: u32) -> Self {
        self.counter[0] = block;
        self
    }

    /// Four random words.
    #[inline]
    pub fn words(&mut self) -> [u32; 4] {
        let block = philox4x32(self.counter, self.key);
        self.counter[0] += 1;
        block
    }

    /// Number of the next block.
    pub fn block(&self) -> u32 {
        self.counter[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers published with the Random123 library.
    #[test]
    fn philox_gives_the_published_answers() {
        assert_eq!(philox4x32([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox4x32([!0; 4], [!0; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
    }

    /// Uniform numbers are midpoints, inside the open interval.
    #[test]
    fn uniform_numbers_are_interval_midpoints() {
        assert!(uniform(0) > 0.0 && uniform(!0) < 1.0);
        assert_eq!(uniform(0) + uniform(!0), 1.0);
        for bits in [0, 511, 512, 0x1234_5678, 0x8000_0000, !0] {
            assert_eq!(f64::from(uniform(bits)), (f64::from(bits >> 9) + 0.5) / f64::from(1 << 23));
            assert_eq!(f64::from(symmetric(bits)), (f64::from(bits >> 16) + 0.5) / f64::from(1 << 15) - 1.0);
        }
    }

    #[test]
    fn streams_of_different_walks_and_chunks_differ() {
        let first = |chunk, walk| Stream::new([1, 2], chunk, walk).words();
        assert_ne!(first(0, 0), first(0, 1));
        assert_ne!(first(0, 0), first(1, 0));
        assert_ne!(first(0, 0), first(1 << 32, 0));
    }
}
