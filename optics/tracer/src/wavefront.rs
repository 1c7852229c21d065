//! The vector kernel: runs many walks at a time, those that wait for the same operation side by side.
//!
//! Walks in the sample are one queue; walks on their way to an interface are one queue per interface and side. The
//! kernel takes a full vector from a queue, performs its operation on all lanes, and puts the walks into the queues for
//! their next operations. Lanes are never idle but for the second of two flights and for the last walks of a chunk; walks
//! that end are replaced at once.
//!
//! Each lane performs the operations of [`super::walk`] one by one, so the walks are the same to the last bit. The order
//! in which they end depends on the pool, never their number or their outcome; the tally processes them by walk.

#![expect(
    clippy::inline_always,
    reason = "what is not inlined is not compiled for the instruction set that was chosen at run time"
)]

mod flight;
mod gate;
mod hits;
mod keep;
mod lanes;
mod numbers;
mod order;
mod permute;
mod table;
mod vector;

use std::sync::atomic::{AtomicBool, Ordering};

use fearless_simd::{Level, Simd, SimdBase, SimdInto, SimdMask, dispatch, u32x16};

use super::Stopped;
use super::exits::{Chunk, Exits, Offset};
use super::light::Light;
use super::math::two_sided;
use super::rng::{FIRST_BLOCK, Stream, uniform};
use super::stack::Stack;
use super::walk::ROULETTE_BLOCKS;
use flight::FlightSample;
use gate::{Fates, GateKind, Route, WalkGate, gate_at_end, gates, reflect_diffusely};
use hits::Hits;
use keep::Keep;
use lanes::{Floats, Mask, POOL, Queue, WIDTH, WalkLanes, Words, count, first_lanes};
use numbers::Philox;
use order::LaneOrder;

/// The queues of waiting walks, and their hits.
#[derive(Debug)]
pub struct Places {
    /// Walks in the sample.
    inside: Queue,
    /// Walks that have reached a face of the sample from inside, not yet sorted by face.
    leaving: Queue,
    /// Walks on their way to each gate.
    waiting: Vec<Queue>,
    hits: Hits,
}

impl Default for Places {
    fn default() -> Self {
        Self { inside: Queue::new(), leaving: Queue::new(), waiting: Vec::new(), hits: Hits::new() }
    }
}

impl Places {
    fn reset(&mut self, gates: usize, walks: u32) {
        self.inside.reset();
        self.leaving.reset_backwards();
        self.waiting.resize_with(gates, Queue::new);
        self.waiting.iter_mut().for_each(Queue::reset);
        self.hits.reset(walks);
    }
}

/// Runs the walks of a chunk with the instructions of `level` and connects them with the light.
pub fn run_chunk(
    level: Level,
    stack: &Stack,
    light: &Light,
    chunk: Chunk,
    stop: &AtomicBool,
    places: &mut Places,
    exits: &mut Exits,
) -> Result<(), Stopped> {
    dispatch!(level, simd => Wavefront::new(simd, stack, light, chunk, places, exits).run(stop))
}

struct Wavefront<'a, S: Simd> {
    simd: S,
    stack: &'a Stack,
    chunk: Chunk,
    random: Philox<S>,
    sample: FlightSample<'a>,
    gates: Vec<WalkGate>,
    at: &'a mut Places,
    /// Gates below and above the sample.
    faces: [usize; 2],
    /// Walks that have been begun, and that have ended.
    begun: u32,
    ended: u32,
    keep: Keep<'a, S>,
    /// Hits of a walk that ends.
    hits_of_one: Vec<Offset>,
}

impl<'a, S: Simd> Wavefront<'a, S> {
    #[inline(always)]
    fn new(
        simd: S,
        stack: &'a Stack,
        light: &'a Light,
        chunk: Chunk,
        at: &'a mut Places,
        exits: &'a mut Exits,
    ) -> Self {
        let gates = gates(stack);
        at.reset(gates.len(), chunk.walks);
        Self {
            simd,
            stack,
            chunk,
            random: Philox::new(simd, chunk),
            sample: FlightSample::new(stack),
            at,
            faces: [gate_at_end(stack, stack.sample, true), gate_at_end(stack, stack.sample, false)],
            gates,
            begun: 0,
            ended: 0,
            keep: Keep::new(simd, light, exits),
            hits_of_one: Vec::new(),
        }
    }

    fn run(mut self, stop: &AtomicBool) -> Result<(), Stopped> {
        // Fewest walks for which a vector of a queue is run: all lanes, as long as other queues can fill them.
        let mut least = WIDTH;
        while self.ended < self.chunk.walks {
            if stop.load(Ordering::Relaxed) {
                return Err(Stopped);
            }
            self.begin_walks();
            let mut idle = true;
            if self.at.inside.len() + self.at.leaving.len() >= least {
                idle = self.at.inside.len() < least;
                self.advance_inside(least);
            }
            for gate in 0..self.gates.len() {
                if self.at.waiting[gate].len() >= least {
                    idle = false;
                    self.pass(gate, least);
                }
            }
            least = if idle { 1 } else { WIDTH };
        }
        Ok(())
    }

    /// Fills the pool with walks on their way to the first interface.
    fn begin_walks(&mut self) {
        self.simd.vectorize(
            #[inline(always)]
            || self.begin_walks_in_vectors(),
        );
    }

    #[inline(always)]
    fn begin_walks_in_vectors(&mut self) {
        while self.begun < self.chunk.walks && (self.begun - self.ended) as usize + WIDTH <= POOL {
            let n = (self.chunk.walks - self.begun).min(WIDTH as u32);
            let float = |value| Floats::splat(self.simd, value);
            let d = self.stack.sensor_direction;
            let walk = u32x16::from_fn(self.simd, |lane| self.begun + lane as u32);
            let walks = WalkLanes {
                x: float(0.0),
                clear_x: float(0.0),
                z: float(0.0),
                dx: float(d.x),
                dy: float(d.y),
                dz: float(d.z),
                length: float(0.0),
                weight: float(1.0),
                scatterings: Words::splat(self.simd, 0),
                block: Words::splat(self.simd, FIRST_BLOCK),
                walk,
                left: self.keep.first_step(self.simd, &self.random, walk),
            };
            self.at.waiting[0].push(self.simd, &walks, first_lanes(self.simd, n as usize));
            self.begun += n;
        }
    }

    /// Two flights for the walks in the sample, in vectors of at least `least` walks. Walks that stay in the sample are
    /// compacted at the front.
    fn advance_inside(&mut self, least: usize) {
        self.simd.vectorize(
            #[inline(always)]
            || self.advance_vectors(least),
        );
    }

    #[inline(always)]
    fn advance_vectors(&mut self, least: usize) {
        let len = self.at.inside.len();
        let (mut at, mut kept) = (0, 0);
        while at < len {
            let all = first_lanes(self.simd, len - at);
            let mut walks = self.at.inside.load(self.simd, at);
            if len - at < least {
                let order = LaneOrder::new(self.simd, all);
                self.at.inside.place(&walks, &order, kept);
                kept += order.chosen();
                break;
            }
            at += WIDTH;
            let lanes = self.play_roulette(&mut walks, all);
            let stay = self.sample.fly_twice(&self.random, &mut walks, lanes, &mut self.keep, &self.at.hits);
            let order = LaneOrder::new(self.simd, stay);
            self.at.inside.place(&walks, &order, kept);
            kept += order.chosen();
            if lanes.all_true() {
                self.at.leaving.push_others_first(&walks, &order);
            } else {
                self.part(&walks, lanes & !stay);
            }
        }
        self.at.inside.truncate(kept);
        while self.at.leaving.len() >= WIDTH || (least < WIDTH && self.at.leaving.len() > 0) {
            let (walks, n) = self.at.leaving.pop_first(self.simd);
            self.part(&walks, first_lanes(self.simd, n));
        }
    }

    /// Sends walks that leave the sample to the face that they have reached.
    #[inline(always)]
    fn part(&mut self, walks: &WalkLanes<S>, lanes: Mask<S>) {
        let down = walks.dz.simd_lt(0.0);
        self.at.waiting[self.faces[0]].push(self.simd, walks, lanes & down);
        self.at.waiting[self.faces[1]].push(self.simd, walks, lanes & !down);
    }

    /// Roulette for the walks whose block is due; returns the lanes that continue.
    #[inline(always)]
    fn play_roulette(&mut self, walks: &mut WalkLanes<S>, lanes: Mask<S>) -> Mask<S> {
        let due = lanes & (walks.block & (ROULETTE_BLOCKS - 1)).simd_eq(0);
        if !due.any_true() {
            return lanes;
        }
        let (walk, mut block, mut weight) =
            (walks.walk.to_array(), walks.block.to_array(), walks.weight.to_array());
        let mut alive = lanes.to_bitmask();
        for lane in bits(due) {
            let mut stream = Stream::new(self.chunk.key, self.chunk.index, walk[lane]).at_block(block[lane]);
            if uniform(stream.words()[0]) < 0.5 {
                alive &= !(1 << lane);
            }
            weight[lane] *= 2.0;
            block[lane] += 1;
        }
        walks.weight = weight.simd_into(self.simd);
        walks.block = block.simd_into(self.simd);
        let alive = Mask::from_bitmask(self.simd, alive);
        self.end(walks, lanes & !alive);
        alive
    }

    /// Takes the walks that wait at a gate through it, in vectors of at least `least` walks.
    ///
    /// The oldest go first: recently stored data are slow to load again in other pieces.
    fn pass(&mut self, gate: usize, least: usize) {
        self.simd.vectorize(
            #[inline(always)]
            || {
                let len = self.at.waiting[gate].len();
                let mut at = 0;
                while at < len && len - at >= least {
                    self.pass_vector(gate, at, first_lanes(self.simd, len - at));
                    at += WIDTH;
                }
                self.at.waiting[gate].drop_first(self.simd, at.min(len));
            },
        );
    }

    #[inline(always)]
    fn pass_vector(&mut self, index: usize, at: usize, lanes: Mask<S>) {
        let gate = self.gates[index];
        let mut walks = self.at.waiting[index].load(self.simd, at);
        let lanes = self.play_roulette(&mut walks, lanes);
        gate.approach(&mut walks);
        let fates = match gate.kind {
            GateKind::Smooth => gate.cross_smooth(&self.random, &mut walks, lanes),
            GateKind::Rough { alpha } => gate.cross_rough(alpha, &self.random, &mut walks, lanes),
            GateKind::Conserving { alpha } => self.cross_conserving(gate, alpha, &mut walks, lanes),
            GateKind::Base => {
                self.push_hits(&walks, lanes);
                let arrived = walks.dz;
                let words = reflect_diffusely(&self.random, &mut walks);
                if self.stack.base_spread_mm > 0.0 {
                    self.spread(&mut walks, words);
                    self.push_hits(&walks, lanes);
                }
                self.keep.hit(&mut walks, arrived, lanes, &self.at.hits);
                let none = Mask::splat(self.simd, false);
                Fates { reflected: lanes, transmitted: none, lost: none }
            }
        };
        self.end(&walks, fates.lost);
        self.go_on(&mut walks, fates.reflected, gate.reflected);
        self.go_on(&mut walks, fates.transmitted, gate.transmitted);
    }

    /// Adds the current places of walks to their hits on the base.
    #[inline(always)]
    fn push_hits(&mut self, walks: &WalkLanes<S>, lanes: Mask<S>) {
        let walk = walks.walk.to_array();
        let (x, clear_x) = (walks.x.to_array(), walks.clear_x.to_array());
        for lane in bits(lanes) {
            self.at.hits.push(walk[lane], Offset { free_paths: x[lane], mm: clear_x[lane] });
        }
    }

    /// Moves walks within the base.
    #[inline(always)]
    fn spread(&self, walks: &mut WalkLanes<S>, words: [Words<S>; 2]) {
        let ([size, side], mut x) = (words.map(SimdBase::to_array), walks.clear_x.to_array());
        let mean = self.stack.base_spread_mm;
        (0..WIDTH).for_each(|lane| x[lane] += two_sided(mean, [size[lane], side[lane]]));
        walks.clear_x = x.simd_into(self.simd);
    }

    /// Nearly all rays leave after one event; the others are followed one after the other.
    #[inline(always)]
    fn cross_conserving(
        &mut self,
        gate: WalkGate,
        alpha: f32,
        walks: &mut WalkLanes<S>,
        lanes: Mask<S>,
    ) -> Fates<S> {
        let came = [walks.dx, walks.dy, walks.dz];
        let (mut fates, again) = gate.cross_conserving(alpha, &self.random, walks, lanes);
        if !again.any_true() {
            return fates;
        }
        let (mut reflected, mut transmitted) = (0, 0);
        let (walk, mut block) = (walks.walk.to_array(), walks.block.to_array());
        let (mut dx, mut dy, mut dz) = (walks.dx.to_array(), walks.dy.to_array(), walks.dz.to_array());
        let came = [came[0].to_array(), came[1].to_array(), came[2].to_array()];
        for lane in bits(again) {
            let d = came.map(|d| d[lane]);
            let (d, through) = gate.cross_one(alpha, self.chunk, walk[lane], &mut block[lane], d);
            [dx[lane], dy[lane], dz[lane]] = d;
            *(if through { &mut transmitted } else { &mut reflected }) |= 1 << lane;
        }
        walks.block = block.simd_into(self.simd);
        [walks.dx, walks.dy, walks.dz] = [dx, dy, dz].map(|d| d.simd_into(self.simd));
        fates.reflected |= Mask::from_bitmask(self.simd, reflected);
        fates.transmitted |= Mask::from_bitmask(self.simd, transmitted);
        fates
    }

    #[inline(always)]
    fn go_on(&mut self, walks: &mut WalkLanes<S>, lanes: Mask<S>, route: Route) {
        if !lanes.any_true() {
            return;
        }
        match route {
            Route::WalkGate(gate) => self.at.waiting[gate].push(self.simd, walks, lanes),
            Route::SampleTop | Route::SampleBottom => {
                let top = self.stack.thickness[self.stack.sample];
                walks.z = Floats::splat(self.simd, if route == Route::SampleTop { top } else { 0.0 });
                self.at.inside.push(self.simd, walks, lanes);
            }
            Route::Out => self.end(walks, lanes),
        }
    }

    /// Ends walks.
    #[inline(always)]
    fn end(&mut self, walks: &WalkLanes<S>, lanes: Mask<S>) {
        if !lanes.any_true() {
            return;
        }
        let walk = walks.walk.to_array();
        for lane in bits(lanes) {
            let walk = walk[lane];
            self.at.hits.take(walk, &mut self.hits_of_one);
            if self.keep.exits.needs_hits(walk) {
                self.keep.exits.add_hits(walk, &self.hits_of_one);
            }
        }
        self.ended += count(lanes) as u32;
    }
}

/// The numbers of the chosen lanes.
#[inline(always)]
fn bits<S: Simd>(lanes: Mask<S>) -> impl Iterator<Item = usize> {
    let mut rest = lanes.to_bitmask();
    std::iter::from_fn(move || {
        let lane = rest.trailing_zeros() as usize;
        rest &= rest.wrapping_sub(1);
        (lane < 64).then_some(lane)
    })
}
