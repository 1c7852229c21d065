//! Vectors of sixteen lanes, one walk each, and queues of walks in structure-of-arrays form.
//!
//! The width is the same for every instruction set: AVX-512 takes one register for it, AVX2 two, SSE and NEON four.
//! Two or four registers a vector keep independent instructions at hand while others wait.

use fearless_simd::{ExtractToken, Simd, SimdBase, SimdMask, SimdSplit, f32x16, mask32x16, u32x16};

pub const WIDTH: usize = 16;

/// Walks that are under way at a time: what keeps every queue's vectors full and still fits the second-level
/// cache. The result does not depend on it.
pub const POOL: usize = 1024;

/// Room of a queue: all walks of the pool, and a vector that may hang over the end.
const ROOM: usize = POOL + WIDTH;

pub type Floats<S> = f32x16<S>;
pub type Words<S> = u32x16<S>;
pub type Mask<S> = mask32x16<S>;

/// The first `n` lanes.
#[inline(always)]
pub fn first_lanes<S: Simd>(simd: S, n: usize) -> Mask<S> {
    Mask::from_bitmask(simd, if n >= WIDTH { 0xffff } else { (1 << n) - 1 })
}

#[inline(always)]
pub fn count<S: Simd>(mask: Mask<S>) -> usize {
    mask.to_bitmask().count_ones() as usize
}

/// Sixteen walks, one a lane. Lengths in mm.
#[derive(Debug, Clone, Copy)]
pub struct Walks<S: Simd> {
    /// Lateral distance from the entry point.
    pub x: Floats<S>,
    /// Height above the lower face of the sample; meaningful inside it.
    pub z: Floats<S>,
    /// Direction of flight.
    pub dx: Floats<S>,
    pub dy: Floats<S>,
    pub dz: Floats<S>,
    /// Length travelled in the sample.
    pub length: Floats<S>,
    pub weight: Floats<S>,
    pub scatterings: Words<S>,
    /// Number of the next block of random numbers.
    pub block: Words<S>,
    /// Place in the chunk.
    pub walk: Words<S>,
}

/// Walks that wait for the same thing.
#[derive(Debug)]
pub struct Queue {
    len: usize,
    x: [f32; ROOM],
    z: [f32; ROOM],
    dx: [f32; ROOM],
    dy: [f32; ROOM],
    dz: [f32; ROOM],
    length: [f32; ROOM],
    weight: [f32; ROOM],
    scatterings: [u32; ROOM],
    block: [u32; ROOM],
    walk: [u32; ROOM],
}

impl Queue {
    pub fn new() -> Self {
        let (floats, words) = ([0.0; ROOM], [0; ROOM]);
        Self {
            len: 0,
            x: floats,
            z: floats,
            dx: floats,
            dy: floats,
            dz: floats,
            length: floats,
            weight: floats,
            scatterings: words,
            block: words,
            walk: words,
        }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    /// The vector that begins at `at`; lanes beyond the end hold anything.
    #[inline(always)]
    pub fn load<S: Simd>(&self, simd: S, at: usize) -> Walks<S> {
        assert!(at <= POOL);
        Walks {
            x: Floats::from_slice(simd, &self.x[at..at + WIDTH]),
            z: Floats::from_slice(simd, &self.z[at..at + WIDTH]),
            dx: Floats::from_slice(simd, &self.dx[at..at + WIDTH]),
            dy: Floats::from_slice(simd, &self.dy[at..at + WIDTH]),
            dz: Floats::from_slice(simd, &self.dz[at..at + WIDTH]),
            length: Floats::from_slice(simd, &self.length[at..at + WIDTH]),
            weight: Floats::from_slice(simd, &self.weight[at..at + WIDTH]),
            scatterings: Words::from_slice(simd, &self.scatterings[at..at + WIDTH]),
            block: Words::from_slice(simd, &self.block[at..at + WIDTH]),
            walk: Words::from_slice(simd, &self.walk[at..at + WIDTH]),
        }
    }

    /// Takes up to a vector of walks from the end: the walks and how many they are.
    #[inline(always)]
    pub fn pop<S: Simd>(&mut self, simd: S) -> (Walks<S>, usize) {
        let n = self.len.min(WIDTH);
        self.len -= n;
        (self.load(simd, self.len), n)
    }

    /// Cuts the queue down to its first `len` walks.
    pub fn truncate(&mut self, len: usize) {
        self.len = len;
    }

    /// Appends the walks of the chosen lanes.
    #[inline(always)]
    pub fn push<S: Simd>(&mut self, walks: &Walks<S>, lanes: Mask<S>) {
        self.len = self.place(walks, lanes, self.len);
    }

    /// Writes the walks of the chosen lanes from `at` on, and anything over the rest of a vector behind them;
    /// returns where they end.
    #[inline(always)]
    pub fn place<S: Simd>(&mut self, walks: &Walks<S>, lanes: Mask<S>, at: usize) -> usize {
        assert!(at <= POOL);
        place_floats(walks.x, lanes, &mut self.x, at);
        place_floats(walks.z, lanes, &mut self.z, at);
        place_floats(walks.dx, lanes, &mut self.dx, at);
        place_floats(walks.dy, lanes, &mut self.dy, at);
        place_floats(walks.dz, lanes, &mut self.dz, at);
        place_floats(walks.length, lanes, &mut self.length, at);
        place_floats(walks.weight, lanes, &mut self.weight, at);
        place_words(walks.scatterings, lanes, &mut self.scatterings, at);
        place_words(walks.block, lanes, &mut self.block, at);
        place_words(walks.walk, lanes, &mut self.walk, at);
        at + count(lanes)
    }
}

/// Stores the chosen lanes side by side, in pieces of the machine's own width.
#[inline(always)]
fn place_floats<S: Simd>(values: Floats<S>, lanes: Mask<S>, room: &mut [f32; ROOM], at: usize) {
    if S::f32s::LEN == WIDTH {
        values.compress(lanes).store_slice(&mut room[at..at + WIDTH]);
        return;
    }
    let (low, high) = values.split();
    let (low_lanes, high_lanes) = values.token().split_mask32x16(lanes);
    low.compress(low_lanes).store_slice(&mut room[at..at + 8]);
    let at = at + low_lanes.to_bitmask().count_ones() as usize;
    high.compress(high_lanes).store_slice(&mut room[at..at + 8]);
}

#[inline(always)]
fn place_words<S: Simd>(values: Words<S>, lanes: Mask<S>, room: &mut [u32; ROOM], at: usize) {
    if S::f32s::LEN == WIDTH {
        values.compress(lanes).store_slice(&mut room[at..at + WIDTH]);
        return;
    }
    let (low, high) = values.split();
    let (low_lanes, high_lanes) = values.token().split_mask32x16(lanes);
    low.compress(low_lanes).store_slice(&mut room[at..at + 8]);
    let at = at + low_lanes.to_bitmask().count_ones() as usize;
    high.compress(high_lanes).store_slice(&mut room[at..at + 8]);
}
