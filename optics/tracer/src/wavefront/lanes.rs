//! Sixteen walks in the lanes of vectors, and queues of walks in structure-of-arrays form.

use fearless_simd::{Bytes, Simd, SimdBase, SimdMask};

use super::order::LaneOrder;
pub use super::vector::{Floats, Mask, WIDTH, Words};

/// Walks that are under way at a time: enough to keep every queue's vectors full, and few enough for the second-level
/// cache. The result does not depend on it.
pub const POOL: usize = 1024;

/// Room of a queue: all walks of the pool, and a vector that may hang over either end.
const ROOM: usize = POOL + 2 * WIDTH;

/// Words that make up the state of a walk.
const STATE: usize = 12;

/// The first `n` lanes.
#[inline(always)]
pub fn first_lanes<S: Simd>(simd: S, n: usize) -> Mask<S> {
    Mask::from_bitmask(simd, if n >= WIDTH { 0xffff } else { (1 << n) - 1 })
}

#[inline(always)]
pub fn count<S: Simd>(mask: Mask<S>) -> usize {
    mask.to_bitmask().count_ones() as usize
}

/// Sixteen walks, one a lane. Lengths in the sample are in mean free paths.
#[derive(Debug, Clone, Copy)]
pub struct WalkLanes<S: Simd> {
    /// Lateral distance from the entry point: the part gathered in the sample, and the part in clear slabs in mm.
    pub x: Floats<S>,
    pub clear_x: Floats<S>,
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
    /// The rest of the step until the next vertex is picked, see [`crate::pick`].
    pub left: Floats<S>,
}

impl<S: Simd> WalkLanes<S> {
    #[inline(always)]
    fn from_words(words: [Words<S>; STATE]) -> Self {
        let [x, clear_x, z, dx, dy, dz, length, weight, scatterings, block, walk, left] = words;
        Self {
            x: x.bitcast(),
            clear_x: clear_x.bitcast(),
            z: z.bitcast(),
            dx: dx.bitcast(),
            dy: dy.bitcast(),
            dz: dz.bitcast(),
            length: length.bitcast(),
            weight: weight.bitcast(),
            scatterings,
            block,
            walk,
            left: left.bitcast(),
        }
    }

    #[inline(always)]
    fn to_words(self) -> [Words<S>; STATE] {
        [
            self.x.bitcast(),
            self.clear_x.bitcast(),
            self.z.bitcast(),
            self.dx.bitcast(),
            self.dy.bitcast(),
            self.dz.bitcast(),
            self.length.bitcast(),
            self.weight.bitcast(),
            self.scatterings,
            self.block,
            self.walk,
            self.left.bitcast(),
        ]
    }
}

/// One word of the state of all walks, aligned so that whole vectors lie in one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct WalkArray([u32; ROOM]);

/// Walks that wait for the same operation: the places `begin..end` of each array.
#[derive(Debug)]
pub struct Queue {
    begin: usize,
    end: usize,
    state: Box<[WalkArray]>,
}

impl Queue {
    pub fn new() -> Self {
        Self { begin: WIDTH, end: WIDTH, state: vec![WalkArray([0; ROOM]); STATE].into() }
    }

    /// Empties the queue, to grow at its end.
    pub fn reset(&mut self) {
        (self.begin, self.end) = (WIDTH, WIDTH);
    }

    /// Empties the queue, to grow at its beginning.
    pub fn reset_backwards(&mut self) {
        (self.begin, self.end) = (WIDTH + POOL, WIDTH + POOL);
    }

    pub fn len(&self) -> usize {
        self.end - self.begin
    }

    /// The vector that begins at a walk; lanes beyond the end hold arbitrary values.
    #[inline(always)]
    pub fn load<S: Simd>(&self, simd: S, at: usize) -> WalkLanes<S> {
        let at = self.begin + at;
        assert!(at <= ROOM - WIDTH);
        let mut words = [Words::splat(simd, 0); STATE];
        for (words, array) in words.iter_mut().zip(&self.state) {
            *words = Words::from_slice(simd, &array.0[at..at + WIDTH]);
        }
        WalkLanes::from_words(words)
    }

    /// Drops the first `n` walks and closes up the rest, which must be less than a vector.
    #[inline(always)]
    pub fn drop_first<S: Simd>(&mut self, simd: S, n: usize) {
        let rest = self.len() - n;
        assert!(rest < WIDTH);
        let walks = self.load(simd, n);
        for (words, array) in walks.to_words().into_iter().zip(&mut self.state) {
            words.store_slice(&mut array.0[self.begin..self.begin + WIDTH]);
        }
        self.truncate(rest);
    }

    /// Takes up to a vector of walks from the beginning.
    #[inline(always)]
    pub fn pop_first<S: Simd>(&mut self, simd: S) -> (WalkLanes<S>, usize) {
        let n = self.len().min(WIDTH);
        let walks = self.load(simd, 0);
        self.begin += n;
        (walks, n)
    }

    /// Cuts the queue down to its first `len` walks.
    pub fn truncate(&mut self, len: usize) {
        self.end = self.begin + len;
    }

    /// Appends the walks of the chosen lanes.
    #[inline(always)]
    pub fn push<S: Simd>(&mut self, simd: S, walks: &WalkLanes<S>, lanes: Mask<S>) {
        let order = LaneOrder::new(simd, lanes);
        self.place(walks, &order, self.len());
        self.end += order.chosen();
    }

    /// Writes the chosen walks of an order from the place `at` on, and arbitrary values over the rest of a vector.
    #[inline(always)]
    pub fn place<S: Simd>(&mut self, walks: &WalkLanes<S>, order: &LaneOrder<S>, at: usize) {
        let at = self.begin + at;
        assert!(at <= ROOM - WIDTH);
        for (words, array) in walks.to_words().into_iter().zip(&mut self.state) {
            order.store_chosen(words, (&mut array.0[at..at + WIDTH]).try_into().expect("a vector's length"));
        }
    }

    /// Puts the other walks of an order before the first, if no lane is empty.
    #[inline(always)]
    pub fn push_others_first<S: Simd>(&mut self, walks: &WalkLanes<S>, order: &LaneOrder<S>) {
        assert!((WIDTH..=ROOM).contains(&self.begin));
        let room = self.begin - WIDTH..self.begin;
        for (words, array) in walks.to_words().into_iter().zip(&mut self.state) {
            order.store_others(words, (&mut array.0[room.clone()]).try_into().expect("a vector's length"));
        }
        self.begin -= WIDTH - order.chosen();
    }
}
