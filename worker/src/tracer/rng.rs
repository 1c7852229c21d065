//! Counter-based random numbers: Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy
//! as 1, 2, 3").
//!
//! A number is a pure function of (key, batch, walk, event): it does not matter which machine, thread or
//! attempt asks for it.

/// Ten rounds of Philox4x32 on a counter.
pub fn philox4x32(counter: [u32; 4], key: [u32; 2]) -> [u32; 4] {
    const MULTIPLIERS: [u64; 2] = [0xD251_1F53, 0xCD9E_8D57];
    const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];
    let [mut c0, mut c1, mut c2, mut c3] = counter;
    let [mut k0, mut k1] = key;
    for _ in 0..10 {
        let a = MULTIPLIERS[0] * u64::from(c0);
        let b = MULTIPLIERS[1] * u64::from(c2);
        (c0, c1, c2, c3) = ((b >> 32) as u32 ^ c1 ^ k0, b as u32, (a >> 32) as u32 ^ c3 ^ k1, a as u32);
        k0 = k0.wrapping_add(WEYL[0]);
        k1 = k1.wrapping_add(WEYL[1]);
    }
    [c0, c1, c2, c3]
}

/// Uniform number from 32 random bits: the midpoint of one of 2²³ equal cells of (0, 1), never 0 or 1.
pub fn uniform(bits: u32) -> f32 {
    ((bits >> 9) as f32 + 0.5) * (1.0 / 8_388_608.0)
}

/// The random numbers of one walk, four per event.
#[derive(Debug, Clone)]
pub struct Stream {
    key: [u32; 2],
    counter: [u32; 4],
}

impl Stream {
    /// `key` stands for seed and transport point, see `farm_proto::digest::stream_key`.
    pub fn new(key: [u32; 2], batch: u64, walk: u32) -> Self {
        Self { key, counter: [0, walk, batch as u32, (batch >> 32) as u32] }
    }

    /// Four uniform numbers for the next event.
    #[inline]
    pub fn next(&mut self) -> [f32; 4] {
        let block = philox4x32(self.counter, self.key);
        self.counter[0] += 1;
        block.map(uniform)
    }

    /// Events that have drawn numbers so far.
    pub fn events(&self) -> u32 {
        self.counter[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers published with the Random123 library.
    #[test]
    fn philox_gives_the_known_answers() {
        assert_eq!(philox4x32([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox4x32([!0; 4], [!0; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
    }

    #[test]
    fn uniform_numbers_stay_inside_the_open_interval() {
        assert!(uniform(0) > 0.0 && uniform(!0) < 1.0);
        assert_eq!(uniform(0) + uniform(!0), 1.0);
    }

    #[test]
    fn streams_of_different_walks_and_batches_differ() {
        let first = |batch, walk| Stream::new([1, 2], batch, walk).next();
        assert_ne!(first(0, 0), first(0, 1));
        assert_ne!(first(0, 0), first(1, 0));
        assert_ne!(first(0, 0), first(1 << 32, 0));
    }
}
