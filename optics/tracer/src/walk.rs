//! Runs one random walk from the sensor through the stack until it leaves through the top.
//!
//! Nothing is absorbed in flight: the albedo enters as α^n at the end, the base's reflectances by the number of
//! hits on either side of the edge. z points up, x across the edge.

use std::sync::atomic::{AtomicBool, Ordering};

use glam::Vec3;

use super::Stopped;
use super::exits::{Chunk, Exits, Offset};
use super::fresnel::{Facet, RelativeIndex};
use super::light::Light;
use super::math::{ln, two_sided, unit_vector};
use super::microfacet::{Scattered, scatter_once, scatter_until_out};
use super::pick::{AT_BASE, PICK_BLOCK, Pick, STEP, cut, importance};
use super::rng::{Stream, uniform};
use super::stack::Stack;

/// Blocks of random numbers between two games of Russian roulette. It bounds the time of walks in optically very thick
/// slabs, and ends those that rounding has trapped: a ray that enters a smooth layer at grazing incidence may find total
/// reflection on both its faces, once in some 10¹⁰ crossings. Without bias; hardly any other walk of the paper's grid
/// reaches the first game. A power of two.
pub const ROULETTE_BLOCKS: u32 = 1 << 15;

/// The event of the last step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WalkEvent {
    /// A scattering in the sample.
    Scattered,
    /// A reflection or refraction at an interface.
    Crossed,
    /// A diffuse reflection at the base: the walk has met its surface at [`Walk::entered`] and left it at the current x.
    Base,
    /// The walk has left through the top.
    Left,
    /// A direction ended on the wrong side of a rough interface.
    Lost,
}

/// State of a walk.
#[derive(Debug)]
pub struct Walk<'a> {
    stack: &'a Stack,
    stream: Stream,
    /// The second half of the last block, for the next flight.
    spare: Option<[u32; 2]>,
    slab: usize,
    /// Height above the lower face of the sample in mean free paths; meaningful inside it.
    z: f32,
    direction: Vec3,
    /// Lateral distance from the entry point.
    pub offset: Offset,
    /// Lateral distance at which the walk entered the base the last time.
    pub entered: Offset,
    /// Product of the microfacets' weights and of roulette's.
    pub weight: f32,
    /// Scattering events so far.
    pub scatterings: u32,
    /// Length travelled in the sample, in mean free paths.
    pub length: f32,
}

impl<'a> Walk<'a> {
    /// Enters the stack from the air above in `direction` (z < 0) at x = 0. The walk has met the first interface when
    /// this returns; the event is the outcome.
    pub fn enter(stack: &'a Stack, direction: Vec3, stream: Stream) -> (Self, WalkEvent) {
        let mut walk = Self {
            stack,
            stream,
            spare: None,
            slab: 0,
            z: 0.0,
            direction,
            offset: Offset::default(),
            entered: Offset::default(),
            weight: 1.0,
            scatterings: 0,
            length: 0.0,
        };
        let event = walk.cross_below();
        (walk, event)
    }

    /// Advances to the next event. Not to be called after [`WalkEvent::Left`] or [`WalkEvent::Lost`].
    #[inline]
    pub fn step(&mut self) -> WalkEvent {
        if self.slab == self.stack.sample { self.fly() } else { self.traverse() }
    }

    /// A block of random numbers for the next event. None if Russian roulette, which is played from time to time with
    /// a block of its own, ends the walk.
    fn draw(&mut self) -> Option<[u32; 4]> {
        if self.stream.block().is_multiple_of(ROULETTE_BLOCKS) {
            if uniform(self.stream.words()[0]) < 0.5 {
                return None;
            }
            self.weight *= 2.0;
        }
        Some(self.stream.words())
    }

    /// Two words for a flight in the sample: a block lasts for two flights in a row.
    fn draw_for_flight(&mut self) -> Option<[u32; 2]> {
        if let Some(words) = self.spare.take() {
            return Some(words);
        }
        let [path, angles, next_path, next_angles] = self.draw()?;
        self.spare = Some([next_path, next_angles]);
        Some([path, angles])
    }

    /// Flies freely in the sample, to a scattering or to a face, whichever comes first.
    fn fly(&mut self) -> WalkEvent {
        let Some([path, angles]) = self.draw_for_flight() else { return WalkEvent::Lost };
        let free = -ln(uniform(path));
        let thickness = self.stack.thickness[self.slab];
        let z = self.z + self.direction.z * free;
        // Only the face ahead counts: a step too short to change z must not pass for a crossing of the other.
        let down = self.direction.z < 0.0;
        let reaches_face = if down { z <= 0.0 } else { z >= thickness && self.direction.z > 0.0 };
        if !reaches_face {
            self.z = z;
            self.offset.free_paths += self.direction.x * free;
            self.length += free;
            self.scatterings += 1;
            self.direction = self.stack.phase.scatter(self.direction.to_array(), angles).into();
            return WalkEvent::Scattered;
        }
        let face = if down { 0.0 } else { thickness };
        let flown = (face - self.z) / self.direction.z;
        self.offset.free_paths += self.direction.x * flown;
        self.length += flown;
        self.spare = None;
        self.leave_slab(down)
    }

    /// Crosses a clear slab to its other face.
    fn traverse(&mut self) -> WalkEvent {
        let thickness_mm = self.stack.thickness[self.slab];
        self.offset.mm += self.direction.x * (thickness_mm / self.direction.z.abs());
        self.leave_slab(self.direction.z < 0.0)
    }

    fn leave_slab(&mut self, down: bool) -> WalkEvent {
        if !down {
            self.cross_above()
        } else if self.slab == self.stack.interfaces.len() {
            self.reflect_diffusely()
        } else {
            self.cross_below()
        }
    }

    /// The Lambertian base: cosine-distributed directions, whatever the side of the edge, after a step within it.
    fn reflect_diffusely(&mut self) -> WalkEvent {
        let Some(words) = self.draw() else { return WalkEvent::Lost };
        let u = uniform(words[1]);
        let (x, y) = unit_vector(words[2]);
        let sin = u.sqrt();
        self.direction = Vec3::new(sin * x, sin * y, (1.0 - u).sqrt());
        self.z = 0.0;
        self.entered = self.offset;
        if self.stack.base_spread_mm > 0.0 {
            self.offset.mm += two_sided(self.stack.base_spread_mm, [words[0], words[3]]);
        }
        WalkEvent::Base
    }

    fn cross_below(&mut self) -> WalkEvent {
        let interface = self.stack.interfaces[self.slab];
        let indices = [interface.from_above, interface.from_below];
        let Some(transmitted) = self.cross(1.0, indices, interface.alpha) else { return WalkEvent::Lost };
        if transmitted {
            self.slab += 1;
            self.z = self.stack.thickness[self.slab];
        } else {
            self.z = 0.0;
            if self.slab == 0 {
                return WalkEvent::Left;
            }
        }
        WalkEvent::Crossed
    }

    fn cross_above(&mut self) -> WalkEvent {
        let interface = self.stack.interfaces[self.slab - 1];
        let indices = [interface.from_below, interface.from_above];
        let Some(transmitted) = self.cross(-1.0, indices, interface.alpha) else { return WalkEvent::Lost };
        if transmitted {
            self.slab -= 1;
            self.z = 0.0;
            if self.slab == 0 {
                return WalkEvent::Left;
            }
        } else {
            self.z = self.stack.thickness[self.slab];
        }
        WalkEvent::Crossed
    }

    /// Meets an interface whose incident side is up (`up` = 1) or down (`up` = −1); `indices` are the indices of the
    /// incident side and of the other. Sets the new direction and returns whether the ray is on the other side; None if
    /// it is lost.
    fn cross(&mut self, up: f32, indices: [RelativeIndex; 2], alpha: f32) -> Option<bool> {
        let d = self.direction;
        let wi = Vec3::new(-d.x, -d.y, -up * d.z);
        let words = self.draw()?;
        let Scattered { direction, weight } = if alpha == 0.0 {
            scatter_smoothly(wi, indices[0], uniform(words[3]))
        } else if self.stack.multiple_scattering {
            Scattered {
                direction: scatter_until_out(wi, alpha, indices, words, &mut self.stream),
                weight: 1.0,
            }
        } else {
            scatter_once(wi, alpha, indices[0], words)?
        };
        self.weight *= weight;
        self.direction = Vec3::new(direction.x, direction.y, up * direction.z);
        Some(direction.z < 0.0)
    }
}

/// Reflects or refracts at a smooth interface with normal z.
fn scatter_smoothly(wi: Vec3, index: RelativeIndex, u: f32) -> Scattered {
    let facet = Facet::new(wi.z, index);
    let direction = if facet.reflects(u) {
        Vec3::new(-wi.x, -wi.y, wi.z)
    } else {
        Vec3::new(-index.eta * wi.x, -index.eta * wi.y, -facet.cos_t)
    };
    Scattered { direction, weight: 1.0 }
}

/// Runs the walks of a chunk one after the other and picks vertices. This is the tracer in its plainest form, with which
/// the vector kernel must agree to the last bit.
pub fn run_chunk(
    stack: &Stack,
    light: &Light,
    chunk: Chunk,
    stop: &AtomicBool,
    exits: &mut Exits,
) -> Result<(), Stopped> {
    let step = STEP * light.measure;
    let mut hits = Vec::new();
    for index in 0..chunk.walks {
        if stop.load(Ordering::Relaxed) {
            return Err(Stopped);
        }
        hits.clear();
        let stream = Stream::new(chunk.key, chunk.index, index);
        let mut left = uniform(stream.clone().at_block(PICK_BLOCK).words()[0]) * step;
        let (mut walk, mut event) = Walk::enter(stack, stack.sensor_direction, stream);
        while event != WalkEvent::Left && event != WalkEvent::Lost {
            let u = walk.direction.z;
            event = walk.step();
            let (z, receives) = match event {
                WalkEvent::Scattered => (walk.z, light.about(walk.z, u)),
                WalkEvent::Base => {
                    if stack.base_spread_mm > 0.0 {
                        hits.push(walk.entered);
                    }
                    hits.push(walk.offset);
                    (AT_BASE, light.base)
                }
                _ => continue,
            };
            let worth = receives * importance(walk.scatterings);
            left -= worth * walk.weight;
            if left < 0.0 {
                let (cuts, hits) = (cut(&mut left, step), hits.len() as u32);
                let Walk { scatterings, length, .. } = walk;
                exits.pick(Pick { walk: index, z, u, worth, cuts, scatterings, hits, length });
            }
        }
        exits.add_hits(index, &hits);
    }
    Ok(())
}

/// Numbers of events of walks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Events {
    pub scatterings: u64,
    /// Reflections and refractions at interfaces, and diffuse reflections at the base.
    pub crossings: u64,
}

/// Counts the events of a chunk's walks.
pub fn count_events(stack: &Stack, chunk: Chunk) -> Events {
    let mut events = Events::default();
    for index in 0..chunk.walks {
        let stream = Stream::new(chunk.key, chunk.index, index);
        let (mut walk, mut event) = Walk::enter(stack, stack.sensor_direction, stream);
        events.crossings += 1;
        while event != WalkEvent::Left && event != WalkEvent::Lost {
            event = walk.step();
            events.crossings += u64::from(event != WalkEvent::Scattered);
        }
        events.scatterings += u64::from(walk.scatterings);
    }
    events
}

#[cfg(test)]
mod tests;
