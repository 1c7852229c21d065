//! One random walk from the sensor through the stack until it leaves through the top.
//!
//! Nothing is absorbed in flight: the albedo enters as α^n at the end, the base's reflectances by the number of
//! hits on either side of the edge. z points up, x across the edge.

use glam::Vec3;

use super::fresnel::{Facet, refract};
use super::math::{ln, sin_cos_turns};
use super::microfacet::{Scattered, scatter_once, scatter_until_out};
use super::rng::Stream;
use super::stack::Stack;

/// Events between two games of Russian roulette. In the paper's grid no walk comes near the first, since the
/// chance to stay falls exponentially; in optically very thick slabs it bounds the time, without bias.
const ROULETTE_EVENTS: u32 = 1 << 16;

/// What the last step did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// A scattering in the sample.
    Scattered,
    /// A reflection or refraction at an interface.
    Crossed,
    /// A diffuse reflection at the base, at the current x.
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
    /// Number of events after which roulette is played next.
    roulette_at: u32,
    slab: usize,
    /// Height above the lower face of the sample; meaningful inside it.
    z_mm: f32,
    direction: Vec3,
    /// Lateral distance from the entry point.
    pub x_mm: f32,
    /// Product of the microfacets' weights and of roulette's.
    pub weight: f32,
    /// Scattering events so far.
    pub scatterings: u32,
    /// Length travelled in the sample.
    pub length_mm: f32,
}

impl<'a> Walk<'a> {
    /// Enters the stack from the air above in `direction` (z < 0) at x = 0. The first interface has been dealt
    /// with when this returns; the event tells how.
    pub fn enter(stack: &'a Stack, direction: Vec3, stream: Stream) -> (Self, Event) {
        let mut walk = Self {
            stack,
            stream,
            roulette_at: ROULETTE_EVENTS,
            slab: 0,
            z_mm: 0.0,
            direction,
            x_mm: 0.0,
            weight: 1.0,
            scatterings: 0,
            length_mm: 0.0,
        };
        let u = walk.stream.next();
        let event = walk.cross_below(u);
        (walk, event)
    }

    /// sin² of the polar angle.
    pub fn sin2(&self) -> f32 {
        let d = self.direction;
        d.x * d.x + d.y * d.y
    }

    /// Advances to the next event. Not to be called after [`Event::Left`] or [`Event::Lost`].
    #[inline]
    pub fn step(&mut self) -> Event {
        if self.stream.events() >= self.roulette_at {
            self.roulette_at += ROULETTE_EVENTS;
            if self.stream.next()[0] < 0.5 {
                return Event::Lost;
            }
            self.weight *= 2.0;
        }
        if self.slab == self.stack.sample { self.fly() } else { self.traverse() }
    }

    /// Flies freely in the sample, to a scattering or to a face, whichever comes first.
    fn fly(&mut self) -> Event {
        let u = self.stream.next();
        let free_mm = -ln(u[0]) * self.stack.mean_free_path_mm;
        let thickness_mm = self.stack.thickness_mm[self.slab];
        let z_mm = self.z_mm + self.direction.z * free_mm;
        // Only the face ahead counts: a step too short to change z must not pass for a crossing of the other.
        let down = self.direction.z < 0.0;
        let reaches_face = if down { z_mm <= 0.0 } else { z_mm >= thickness_mm && self.direction.z > 0.0 };
        if !reaches_face {
            self.z_mm = z_mm;
            self.x_mm += self.direction.x * free_mm;
            self.length_mm += free_mm;
            self.scatterings += 1;
            self.direction = self.stack.phase.scatter(self.direction, u[1], u[2]);
            return Event::Scattered;
        }
        let face_mm = if down { 0.0 } else { thickness_mm };
        let flown_mm = (face_mm - self.z_mm) / self.direction.z;
        self.z_mm = face_mm;
        self.x_mm += self.direction.x * flown_mm;
        self.length_mm += flown_mm;
        self.leave_slab(down, u)
    }

    /// Crosses a clear slab to its other face.
    fn traverse(&mut self) -> Event {
        let u = self.stream.next();
        let thickness_mm = self.stack.thickness_mm[self.slab];
        self.x_mm += self.direction.x * (thickness_mm / self.direction.z.abs());
        self.leave_slab(self.direction.z < 0.0, u)
    }

    fn leave_slab(&mut self, down: bool, u: [f32; 4]) -> Event {
        if !down {
            self.cross_above(u)
        } else if self.slab == self.stack.interfaces.len() {
            self.reflect_diffusely(u)
        } else {
            self.cross_below(u)
        }
    }

    /// The Lambertian base: cosine-distributed directions, whatever the side of the edge.
    fn reflect_diffusely(&mut self, u: [f32; 4]) -> Event {
        let (sin_phi, cos_phi) = sin_cos_turns(u[2]);
        let sin = u[1].sqrt();
        self.direction = Vec3::new(sin * cos_phi, sin * sin_phi, (1.0 - u[1]).sqrt());
        Event::Base
    }

    fn cross_below(&mut self, u: [f32; 4]) -> Event {
        let interface = self.stack.interfaces[self.slab];
        let Some(transmitted) =
            self.cross(-self.direction, 1.0, interface.eta_from_above, interface.alpha, u)
        else {
            return Event::Lost;
        };
        if transmitted {
            self.slab += 1;
            self.z_mm = self.stack.thickness_mm[self.slab];
        } else if self.slab == 0 {
            return Event::Left;
        }
        Event::Crossed
    }

    fn cross_above(&mut self, u: [f32; 4]) -> Event {
        let interface = self.stack.interfaces[self.slab - 1];
        let Some(transmitted) =
            self.cross(-self.direction, -1.0, interface.eta_from_below, interface.alpha, u)
        else {
            return Event::Lost;
        };
        if transmitted {
            self.slab -= 1;
            self.z_mm = 0.0;
            if self.slab == 0 {
                return Event::Left;
            }
        }
        Event::Crossed
    }

    /// Meets an interface whose incident side is up (`up` = 1) or down (`up` = −1); `wi` points back along the
    /// ray. Sets the new direction and tells whether the ray is on the other side; None if it is lost.
    fn cross(&mut self, wi: Vec3, up: f32, eta: f32, alpha: f32, u: [f32; 4]) -> Option<bool> {
        let wi = Vec3::new(wi.x, wi.y, up * wi.z);
        let Scattered { direction, weight } = if alpha == 0.0 {
            scatter_smoothly(wi, eta, u[3])
        } else if self.stack.multiple_scattering {
            scatter_until_out(wi, alpha, eta, &mut self.stream)
        } else {
            scatter_once(wi, alpha, eta, u)?
        };
        self.weight *= weight;
        self.direction = Vec3::new(direction.x, direction.y, up * direction.z);
        Some(direction.z < 0.0)
    }
}

/// Reflects or refracts at a smooth interface with normal z.
fn scatter_smoothly(wi: Vec3, eta: f32, u: f32) -> Scattered {
    let facet = Facet::new(wi.z, wi.x * wi.x + wi.y * wi.y, eta);
    let direction = if u < facet.reflectance {
        Vec3::new(-wi.x, -wi.y, wi.z)
    } else {
        refract(wi, Vec3::Z, wi.z, facet.cos_t, eta)
    };
    Scattered { direction, weight: 1.0 }
}

/// A walk that has left through the top.
#[derive(Debug, Clone, Copy)]
pub struct Exit {
    pub weight: f32,
    pub sin2: f32,
    pub scatterings: u32,
    pub length_mm: f32,
}

/// Runs a whole walk from the sensor; the lateral offsets of its hits on the base go to `hits_mm`. None if it
/// was lost.
pub fn run(stack: &Stack, stream: Stream, hits_mm: &mut Vec<f32>) -> Option<Exit> {
    hits_mm.clear();
    let (mut walk, mut event) = Walk::enter(stack, stack.sensor_direction, stream);
    loop {
        match event {
            Event::Scattered | Event::Crossed => {}
            Event::Base => hits_mm.push(walk.x_mm),
            Event::Lost => return None,
            Event::Left => {
                return Some(Exit {
                    weight: walk.weight,
                    sin2: walk.sin2(),
                    scatterings: walk.scatterings,
                    length_mm: walk.length_mm,
                });
            }
        }
        event = walk.step();
    }
}
