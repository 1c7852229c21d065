//! Moves chosen lanes to the front of a vector and the others behind them.

use fearless_simd::{ExtractToken, Simd, SimdBase, SimdMask, SimdSplit, mask32x8, mask32x16, u32x8, u32x16};

use super::permute::{permute8, permute16};
use super::vector::{Mask, WIDTH, Words};

/// For every choice of eight lanes: the chosen ones, then the others, each in order.
static CHOSEN_FIRST: [[u32; 8]; 256] = chosen_first();

const fn chosen_first() -> [[u32; 8]; 256] {
    let mut table = [[0; 8]; 256];
    let mut choice = 0;
    while choice < 256 {
        let (mut place, mut wanted) = (0, 1);
        loop {
            let mut lane = 0;
            while lane < 8 {
                if (choice >> lane) & 1 == wanted {
                    table[choice][place] = lane;
                    place += 1;
                }
                lane += 1;
            }
            if wanted == 0 {
                break;
            }
            wanted = 0;
        }
        choice += 1;
    }
    table
}

/// A permutation of lanes that puts the chosen ones first. Found once, it serves for every word of the walks: one
/// instruction each with AVX2 and AVX-512.
///
/// Machines with eight lanes a register are sorted in two halves, others in quarters.
#[derive(Debug, Clone, Copy)]
pub struct LaneOrder<S: Simd> {
    lanes: Mask<S>,
    whole: u32x16<S>,
    halves: [u32x8<S>; 2],
    /// Chosen lanes in each half.
    counts: [usize; 2],
}

impl<S: Simd> LaneOrder<S> {
    #[inline(always)]
    pub fn new(simd: S, lanes: Mask<S>) -> Self {
        let bits = lanes.to_bitmask() as usize;
        let counts = [(bits & 0xff).count_ones() as usize, (bits >> 8 & 0xff).count_ones() as usize];
        let (mut whole, mut halves) = (u32x16::splat(simd, 0), [u32x8::splat(simd, 0); 2]);
        if S::u32s::LEN == WIDTH {
            let numbers = u32x16::from_slice(simd, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]);
            let behind = mask32x16::from_bitmask(simd, (0xffff << (counts[0] + counts[1])) & 0xffff);
            whole = numbers.compress(!lanes).expand_merge(behind, numbers.compress(lanes));
        } else if S::u32s::LEN == WIDTH / 2 {
            halves = [
                u32x8::from_slice(simd, &CHOSEN_FIRST[bits & 0xff]),
                u32x8::from_slice(simd, &CHOSEN_FIRST[bits >> 8 & 0xff]),
            ];
        }
        Self { lanes, whole, halves, counts }
    }

    /// Number of chosen lanes.
    #[inline(always)]
    pub fn chosen(&self) -> usize {
        self.counts[0] + self.counts[1]
    }

    /// Writes the chosen lanes side by side to the beginning of `room`, and arbitrary values behind them.
    #[inline(always)]
    pub fn store_chosen(&self, words: Words<S>, room: &mut [u32; WIDTH]) {
        if S::u32s::LEN == WIDTH {
            permute16(words, self.whole).store_slice(room);
            return;
        }
        let (low, high) = self.halves(words, self.lanes);
        low.store_slice(&mut room[..8]);
        high.store_slice(&mut room[self.counts[0]..self.counts[0] + 8]);
    }

    /// Writes the other lanes side by side to the end of `room`, and arbitrary values before them.
    #[inline(always)]
    pub fn store_others(&self, words: Words<S>, room: &mut [u32; WIDTH]) {
        if S::u32s::LEN == WIDTH {
            permute16(words, self.whole).store_slice(room);
        } else if S::u32s::LEN == WIDTH / 2 {
            let (low, high) = self.halves(words, self.lanes);
            let others = 8 - self.counts[1];
            // The low half comes last: it must not be overwritten by the lanes that the high one writes before its
            // others.
            high.store_slice(&mut room[8..]);
            low.store_slice(&mut room[8 - others..16 - others]);
        } else {
            let (low, high) = self.halves(words, !self.lanes);
            let others = [8 - self.counts[0], 8 - self.counts[1]];
            let begin = 16 - others[0] - others[1];
            let (low, high): ([u32; 8], [u32; 8]) = (low.into(), high.into());
            room[begin..begin + others[0]].copy_from_slice(&low[..others[0]]);
            room[begin + others[0]..].copy_from_slice(&high[..others[1]]);
        }
    }

    /// Both halves with their lanes in order.
    #[inline(always)]
    fn halves(&self, words: Words<S>, lanes: Mask<S>) -> (u32x8<S>, u32x8<S>) {
        let (low, high) = words.split();
        if S::u32s::LEN == WIDTH / 2 {
            return (permute8(low, self.halves[0]), permute8(high, self.halves[1]));
        }
        let (low_lanes, high_lanes): (mask32x8<S>, mask32x8<S>) = lanes.token().split_mask32x16(lanes);
        (low.compress(low_lanes), high.compress(high_lanes))
    }
}
