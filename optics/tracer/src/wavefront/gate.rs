//! Gates: the interface or base at the end of a slab, seen from one side. All walks in a gate's queue meet the same
//! interface from the same side, so its parameters and the slab behind it are constants.

use fearless_simd::{Simd, SimdBase, SimdFloat};

use super::lanes::{Floats, Mask, WalkLanes, Words};
use super::numbers::{Philox, choose, constant, level, minus_ln_at_most, root, uniform, unit_vector};
use crate::exits::Chunk;
use crate::fresnel::RelativeIndex;
use crate::microfacet::scatter_until_out;
use crate::rng::Stream;
use crate::stack::Stack;

/// The destination of a walk after a gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Route {
    /// Into the sample, through its upper face or from its lower face.
    SampleTop,
    SampleBottom,
    /// Through a clear slab to the gate at its end.
    WalkGate(usize),
    /// Out of the stack.
    Out,
}

/// The kind of event at a gate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GateKind {
    Smooth,
    Rough {
        alpha: f32,
    },
    /// Rough, and rays are followed until they leave.
    Conserving {
        alpha: f32,
    },
    /// The Lambertian base.
    Base,
}

#[derive(Debug, Clone, Copy)]
pub struct WalkGate {
    pub kind: GateKind,
    /// Thickness of the slab that ends here, see [`Stack::thickness`].
    thickness: f32,
    /// The slab is the sample: walks come from anywhere in it, and its length counts.
    from_sample: bool,
    /// Whether walks come down to the gate.
    down: bool,
    /// Indices of the incident side and of the other.
    indices: [RelativeIndex; 2],
    pub reflected: Route,
    pub transmitted: Route,
}

/// The gates of a stack: two for every interface, from above and from below, and the base.
pub fn gates(stack: &Stack) -> Vec<WalkGate> {
    let last = stack.interfaces.len();
    let mut gates = Vec::with_capacity(2 * last + 1);
    for (i, interface) in stack.interfaces.iter().enumerate() {
        let kind = match interface.alpha {
            0.0 => GateKind::Smooth,
            alpha if stack.multiple_scattering => GateKind::Conserving { alpha },
            alpha => GateKind::Rough { alpha },
        };
        let (above, below) = (interface.from_above, interface.from_below);
        for down in [true, false] {
            let slab = if down { i } else { i + 1 };
            gates.push(WalkGate {
                kind,
                thickness: stack.thickness[slab],
                from_sample: slab == stack.sample,
                down,
                indices: if down { [above, below] } else { [below, above] },
                reflected: route(stack, slab, !down),
                transmitted: route(stack, if down { i + 1 } else { i }, down),
            });
        }
    }
    gates.push(WalkGate {
        kind: GateKind::Base,
        thickness: stack.thickness[last],
        from_sample: last == stack.sample,
        down: true,
        // Unused: nothing passes the base.
        indices: [RelativeIndex::new(1.0, 1.0); 2],
        reflected: route(stack, last, false),
        transmitted: Route::Out,
    });
    gates
}

/// The route of a walk that starts in a slab, at the face that is behind it.
fn route(stack: &Stack, slab: usize, down: bool) -> Route {
    match slab {
        0 => Route::Out,
        _ if slab == stack.sample && down => Route::SampleTop,
        _ if slab == stack.sample => Route::SampleBottom,
        _ => Route::WalkGate(gate_at_end(stack, slab, down)),
    }
}

/// The gate that a walk in the slab reaches.
pub fn gate_at_end(stack: &Stack, slab: usize, down: bool) -> usize {
    if cfg!(test) {
        // The base has the number that the next interface would have.
        assert!(slab <= stack.interfaces.len());
    }
    if down { 2 * slab } else { 2 * slab - 1 }
}

/// The outcome for the walks at a gate.
pub struct Fates<S: Simd> {
    pub reflected: Mask<S>,
    pub transmitted: Mask<S>,
    pub lost: Mask<S>,
}

impl WalkGate {
    /// Flies straight to the end of the slab.
    #[inline(always)]
    pub fn approach<S: Simd>(&self, walks: &mut WalkLanes<S>) {
        if self.from_sample {
            let face = if self.down { 0.0 } else { self.thickness };
            let flown = (constant(walks.z, face) - walks.z) / walks.dz;
            walks.x += walks.dx * flown;
            walks.length += flown;
        } else {
            walks.clear_x += walks.dx * (constant(walks.z, self.thickness) / walks.dz.abs());
        }
    }

    /// Towards the incident side: the reversed directions, with z the cosine.
    #[inline(always)]
    fn back<S: Simd>(&self, walks: &WalkLanes<S>) -> [Floats<S>; 3] {
        [-walks.dx, -walks.dy, if self.down { -walks.dz } else { walks.dz }]
    }

    /// Reflects or refracts the chosen lanes at a smooth interface.
    #[inline(always)]
    pub fn cross_smooth<S: Simd>(
        &self,
        random: &Philox<S>,
        walks: &mut WalkLanes<S>,
        lanes: Mask<S>,
    ) -> Fates<S> {
        let [_, _, _, choice] = random.words(walks.block, walks.walk);
        walks.block += 1;
        let (wi, index) = (self.back(walks), self.indices[0]);
        let (cos_t, reflects) = fresnel(wi[2], index, uniform(choice));
        let e = choose(reflects, constant(cos_t, 1.0), constant(cos_t, index.eta));
        self.turn(walks, [-(wi[0] * e), -(wi[1] * e), choose(reflects, wi[2], -cos_t)]);
        Fates { reflected: lanes & reflects, transmitted: lanes & !reflects, lost: lanes & !lanes }
    }

    /// Reflects or refracts the chosen lanes once at a rough interface.
    #[inline(always)]
    pub fn cross_rough<S: Simd>(
        &self,
        alpha: f32,
        random: &Philox<S>,
        walks: &mut WalkLanes<S>,
        lanes: Mask<S>,
    ) -> Fates<S> {
        let [_, radial, azimuth, choice] = random.words(walks.block, walks.walk);
        walks.block += 1;
        let (wi, index) = (self.back(walks), self.indices[0]);
        let m = visible_normal(stretch(wi, alpha), alpha, uniform(radial), unit_vector(azimuth));
        let (wo, reflects) = scatter(wi, m, index, uniform(choice));
        let cos = choose(reflects, wo[2], -wo[2]);
        let sin2 = wo[0] * wo[0] + wo[1] * wo[1];
        walks.weight *= (cos + cos) / (cos + (cos * cos + sin2 * (alpha * alpha)).sqrt());
        let kept = lanes & cos.simd_gt(0.0);
        self.turn(walks, wo);
        Fates { reflected: kept & reflects, transmitted: kept & !reflects, lost: lanes & !kept }
    }

    /// Sets the directions from those in the gate's frame, whose z points to the incident side.
    #[inline(always)]
    fn turn<S: Simd>(&self, walks: &mut WalkLanes<S>, [x, y, z]: [Floats<S>; 3]) {
        (walks.dx, walks.dy) = (x, y);
        walks.dz = if self.down { z } else { -z };
    }

    /// Reflects or refracts the chosen lanes at a rough interface that loses no light. The few whose rays may meet it
    /// again are returned separately.
    #[inline(always)]
    pub fn cross_conserving<S: Simd>(
        &self,
        alpha: f32,
        random: &Philox<S>,
        walks: &mut WalkLanes<S>,
        lanes: Mask<S>,
    ) -> (Fates<S>, Mask<S>) {
        let [next, radial, azimuth, choice] = random.words(walks.block, walks.walk);
        let (wi, index) = (self.back(walks), self.indices[0]);
        let stretched = stretch(wi, alpha);
        let m = visible_normal(stretched, alpha, uniform(radial), unit_vector(azimuth));
        let (wo, reflects) = scatter(wi, m, index, uniform(choice));
        let level = level(azimuth);
        let cos = choose(reflects, wo[2], -wo[2]);
        let slant = (cos * cos + (wo[0] * wo[0] + wo[1] * wo[1]) * (alpha * alpha)).sqrt();
        let level = choose(reflects, level, stretched[2] * (constant(level, 1.0) - level));
        let clears = ((slant - cos) * minus_ln_at_most(level)).simd_lt((cos + cos) * uniform(next));
        let (out, again) = (lanes & clears, lanes & !clears);
        walks.block += 1;
        self.turn(walks, wo);
        (Fates { reflected: out & reflects, transmitted: out & !reflects, lost: lanes & !lanes }, again)
    }

    /// Sends one ray, with `block` the next after that of its first event, over the microsurface until it leaves.
    #[inline(never)]
    pub fn cross_one(
        &self,
        alpha: f32,
        chunk: Chunk,
        walk: u32,
        block: &mut u32,
        d: [f32; 3],
    ) -> ([f32; 3], bool) {
        let up = if self.down { 1.0 } else { -1.0 };
        let wi = glam::Vec3::new(-d[0], -d[1], -up * d[2]);
        let mut stream = Stream::new(chunk.key, chunk.index, walk).at_block(*block - 1);
        let words = stream.words();
        let wo = scatter_until_out(wi, alpha, self.indices, words, &mut stream);
        *block = stream.block();
        ([wo.x, wo.y, up * wo.z], wo.z < 0.0)
    }
}

/// The Lambertian base: cosine-distributed directions upwards. Returns the words that are left for a step within the base.
#[inline(always)]
pub fn reflect_diffusely<S: Simd>(random: &Philox<S>, walks: &mut WalkLanes<S>) -> [Words<S>; 2] {
    let [size, polar, azimuth, side] = random.words(walks.block, walks.walk);
    walks.block += 1;
    let u = uniform(polar);
    let (x, y) = unit_vector(azimuth);
    let sin = u.sqrt();
    (walks.dx, walks.dy) = (sin * x, sin * y);
    walks.dz = (constant(u, 1.0) - u).sqrt();
    [size, side]
}

/// Cosine of the angle of refraction, and the lanes that are reflected.
#[inline(always)]
fn fresnel<S: Simd>(cos_i: Floats<S>, index: RelativeIndex, u: Floats<S>) -> (Floats<S>, Mask<S>) {
    let RelativeIndex { eta, squared, complement } = index;
    let cos_t = root(cos_i * cos_i * squared + complement);
    let (a, b) = (cos_i * eta, cos_t * eta);
    let (s, s_below) = (a - cos_t, a + cos_t);
    let (p, p_below) = (cos_i - b, cos_i + b);
    let (s, p, below) = (s * p_below, p * s_below, s_below * p_below);
    let reflects = ((u + u) * (below * below)).simd_lt(s * s + p * p) | cos_t.simd_le(0.0);
    (cos_t, reflects)
}

/// Direction after reflection or refraction at a facet, and the lanes that are reflected.
#[inline(always)]
fn scatter<S: Simd>(
    wi: [Floats<S>; 3],
    m: [Floats<S>; 3],
    index: RelativeIndex,
    u: Floats<S>,
) -> ([Floats<S>; 3], Mask<S>) {
    let cos_i = wi[0] * m[0] + wi[1] * m[1] + wi[2] * m[2];
    let (cos_t, reflects) = fresnel(cos_i, index, u);
    let k = choose(reflects, cos_i * 2.0, cos_i * index.eta - cos_t);
    let e = choose(reflects, constant(k, 1.0), constant(k, index.eta));
    ([m[0] * k - wi[0] * e, m[1] * k - wi[1] * e, m[2] * k - wi[2] * e], reflects)
}

/// The direction on the surface stretched to roughness 1, see [`crate::microfacet`].
#[inline(always)]
fn stretch<S: Simd>(wi: [Floats<S>; 3], alpha: f32) -> [Floats<S>; 3] {
    unit([wi[0] * alpha, wi[1] * alpha, wi[2]])
}

/// Normals visible from stretched directions.
#[inline(always)]
fn visible_normal<S: Simd>(
    stretched: [Floats<S>; 3],
    alpha: f32,
    u: Floats<S>,
    (x, y): (Floats<S>, Floats<S>),
) -> [Floats<S>; 3] {
    let one = constant(u, 1.0);
    let h_z = (one - u) * (one + stretched[2]);
    let c_z = h_z - stretched[2];
    let sin = root(one - c_z * c_z);
    unit([(sin * x + stretched[0]) * alpha, (sin * y + stretched[1]) * alpha, h_z])
}

#[inline(always)]
fn unit<S: Simd>([x, y, z]: [Floats<S>; 3]) -> [Floats<S>; 3] {
    let inverse = constant(x, 1.0) / (x * x + y * y + z * z).sqrt();
    [x * inverse, y * inverse, z * inverse]
}
