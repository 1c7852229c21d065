//! Samples the sample's phase function: cosines of scattering angles, and directions of walks after a scattering.
//! Each formula is written once, for one walk and for walks in the lanes of a vector, with the same bits.

#![expect(
    clippy::inline_always,
    reason = "the vector kernel compiles for its instructions what is inlined into it"
)]

use std::ops::{Add, Div, Mul, Sub};
use std::sync::Arc;

use optics_model::phase::{PhaseFunction, SecondLobe};

use super::math::unit_vector;
use super::rng::symmetric;

/// A number of one walk, or the same number of all walks in the lanes of a vector.
pub trait Lanes:
    Copy
    + Add<Output = Self>
    + Add<f32, Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Mul<f32, Output = Self>
    + Div<Output = Self>
{
    /// 32 random bits for each walk.
    type Bits: Copy;

    /// Uniform in (−1, 1), from the upper 16 bits.
    fn symmetric(bits: Self::Bits) -> Self;

    /// (cos φ, sin φ), from the lower 16 bits.
    fn unit_vector(bits: Self::Bits) -> (Self, Self);

    /// A value in as many lanes.
    fn constant(self, value: f32) -> Self;

    fn magnitude(self) -> Self;

    /// √max(self, 0).
    fn root(self) -> Self;

    /// The number with its sign changed where `by` is negative.
    fn flip(self, by: Self) -> Self;

    /// The first value where the number is below a limit, the second elsewhere.
    fn below(self, limit: f32, values: [f32; 2]) -> Self;

    /// The numbers of a table at the places in the upper 16 bits.
    fn look_up(table: &[f32; QUANTILES], bits: Self::Bits) -> Self;
}

/// Number of cosines that a scattering angle may have.
pub const QUANTILES: usize = 1 << 16;

impl Lanes for f32 {
    type Bits = u32;

    fn symmetric(bits: u32) -> Self {
        symmetric(bits)
    }

    fn unit_vector(bits: u32) -> (Self, Self) {
        unit_vector(bits)
    }

    fn constant(self, value: f32) -> Self {
        value
    }

    fn magnitude(self) -> Self {
        self.abs()
    }

    fn root(self) -> Self {
        self.max(0.0).sqrt()
    }

    fn flip(self, by: Self) -> Self {
        Self::from_bits(self.to_bits() ^ (by.to_bits() & 0x8000_0000))
    }

    fn below(self, limit: f32, [below, beyond]: [f32; 2]) -> Self {
        if self < limit { below } else { beyond }
    }

    fn look_up(table: &[f32; QUANTILES], bits: u32) -> Self {
        table[(bits >> 16) as usize]
    }
}

/// Samples a [`PhaseFunction`] in single precision.
#[derive(Debug, Clone)]
pub struct PhaseSampler {
    function: PhaseFunction,
    cosines: Cosines,
}

/// The inverse of a distribution function of cosines.
#[derive(Debug, Clone)]
enum Cosines {
    Lobe(Lobe),
    Lobes(Lobes),
    Table(Arc<[f32; QUANTILES]>),
}

/// Henyey–Greenstein.
#[derive(Debug, Clone, Copy)]
struct Lobe {
    g: f32,
    /// g (1 + g²)/2, 1 + g², g (3 − g²)/2: the numerator's coefficients, highest power first.
    numerator: [f32; 3],
}

/// Two lobes: numbers in (−1, 1) below the limit belong to the second.
#[derive(Debug, Clone, Copy)]
struct Lobes {
    limit: f32,
    /// Factor and offset that map the numbers of a lobe to (−1, 1): of the second lobe, and of the first.
    factor: [f32; 2],
    offset: [f32; 2],
    g: [f32; 2],
    /// By coefficient.
    numerator: [[f32; 2]; 3],
}

impl Lobe {
    fn new(g: f64) -> Self {
        let numerator = [g * (1.0 + g * g) / 2.0, 1.0 + g * g, g * (3.0 - g * g) / 2.0];
        Self { g: g as f32, numerator: numerator.map(|v| v as f32) }
    }

    /// Cosine of the scattering angle from a number uniform in (−1, 1).
    ///
    /// The inverse of the distribution function, written without a division by g:
    /// cos θ = [gξ²(1+g²)/2 + ξ(1+g²) + g(3−g²)/2] / (1+gξ)², valid for every g including 0. Rounding may carry it past
    /// ±1 by an ulp or two.
    ///
    /// In a narrow forward peak 1 − cos θ is a difference of nearly equal numbers. Against double precision over all 2¹⁶
    /// numbers, its mean has a relative error of at most 1.2e-5 up to g = 0.95, 2.4e-4 up to 0.99 and 8e-4 up to 0.995; at
    /// 0.999 it is 2.6 % too small.
    #[inline(always)]
    fn cosine<L: Lanes>(&self, xi: L) -> L {
        let [c2, c1, c0] = self.numerator;
        let root = xi * self.g + 1.0;
        ((xi * c2 + c1) * xi + c0) / (root * root)
    }
}

impl Lobes {
    /// The second lobe has the lowest numbers, so that a function without it and one with it give similar cosines.
    fn new(first: f64, second: SecondLobe) -> Self {
        let b = second.weight();
        let [of_second, of_first] = [second.g(), first].map(Lobe::new);
        let factor = [1.0 / b, 1.0 / (1.0 - b)];
        Self {
            limit: (2.0 * b - 1.0) as f32,
            factor: factor.map(|v| v as f32),
            offset: [factor[0] - 1.0, 1.0 - factor[1]].map(|v| v as f32),
            g: [of_second.g, of_first.g],
            numerator: std::array::from_fn(|i| [of_second.numerator[i], of_first.numerator[i]]),
        }
    }

    /// As [`Lobe::cosine`], with the number scaled to its lobe.
    #[inline(always)]
    fn cosine<L: Lanes>(&self, xi: L) -> L {
        let lobe_value = |values: [f32; 2]| xi.below(self.limit, values);
        let scaled = xi * lobe_value(self.factor) + lobe_value(self.offset);
        let [c2, c1, c0] = self.numerator;
        let root = scaled * lobe_value(self.g) + 1.0;
        ((scaled * lobe_value(c2) + lobe_value(c1)) * scaled + lobe_value(c0)) / (root * root)
    }
}

impl PhaseSampler {
    pub fn new(function: &PhaseFunction) -> Self {
        let walked = function.with_walk_weight();
        let cosines = match &walked {
            PhaseFunction::Lobes { first, second } if second.weight() == 0.0 => {
                Cosines::Lobe(Lobe::new(*first))
            }
            PhaseFunction::Lobes { first, second } => Cosines::Lobes(Lobes::new(*first, *second)),
            PhaseFunction::Table(table) => {
                let cosines = table.cosines_at_quantiles(QUANTILES);
                Cosines::Table(Arc::new(cosines.try_into().expect("as many cosines as asked for")))
            }
        };
        Self { function: walked.in_single_precision(), cosines }
    }

    /// The phase function of the rounded parameters.
    pub fn function(&self) -> &PhaseFunction {
        &self.function
    }

    /// Direction after scattering of a unit vector; 16 of the bits make the polar angle, 16 the azimuth.
    #[inline(always)]
    pub fn scatter<L: Lanes>(&self, direction: [L; 3], bits: L::Bits) -> [L; 3] {
        let cos = self.cosine::<L>(bits);
        let sin = (cos.constant(1.0) - cos * cos).root();
        let (x, y) = L::unit_vector(bits);
        rotate(direction, [sin * x, sin * y, cos])
    }

    #[inline(always)]
    fn cosine<L: Lanes>(&self, bits: L::Bits) -> L {
        match &self.cosines {
            Cosines::Lobe(lobe) => lobe.cosine(L::symmetric(bits)),
            Cosines::Lobes(lobes) => lobes.cosine(L::symmetric(bits)),
            Cosines::Table(cosines) => L::look_up(cosines, bits),
        }
    }
}

/// The vector with coordinates (x, y, z) in a frame whose third axis is the unit vector `n`.
///
/// Half a turn about u = n ± e_z carries ±e_z to n and needs no frame: v = u (u·l)/(1 + |n_z|) − l with
/// l = (x, y, ±z), the sign being that of n_z. If |n|² = 1 + ε, then |v|² = 1 + ε k² with k the bracket below,
/// and k² has mean at most 1 over the azimuth: rounding errors do not accumulate, and no normalisation is needed.
#[inline(always)]
fn rotate<L: Lanes>([nx, ny, nz]: [L; 3], [x, y, z]: [L; 3]) -> [L; 3] {
    let q = (nx * x + ny * y) / (nz.magnitude() + 1.0);
    let k = q + z;
    [nx * k - x, ny * k - y, nz * k + q.flip(nz)]
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use optics_model::phase::{PhaseShape, PhaseTable};

    use super::*;
    use crate::rng::Stream;
    use crate::testing::chi_square;

    fn henyey_greenstein(g: f64) -> PhaseFunction {
        PhaseFunction::henyey_greenstein(g).unwrap()
    }

    fn two_lobes([g, weight, of_second]: [f64; 3]) -> PhaseFunction {
        PhaseShape::Lobes(SecondLobe::new(weight, of_second).unwrap()).function(g).unwrap()
    }

    /// With both peaks, a step and a gap.
    fn table() -> PhaseFunction {
        let angles = vec![0.0, 10.0, 40.0, 90.0, 91.0, 120.0, 150.0, 180.0];
        let table = PhaseTable::new(angles, vec![9.0, 3.0, 1.0, 1.0, 0.2, 0.0, 0.0, 2.0]).unwrap();
        PhaseFunction::Table(Arc::new(table))
    }

    /// g, b, g₂.
    const TWO_LOBES: [[f64; 3]; 4] =
        [[0.4, 0.1, -0.5], [0.4, 0.25, -0.65], [0.7, 0.12, -0.5], [-0.2, 0.5, 0.3]];

    fn scatter(phase: &PhaseSampler, direction: Vec3, bits: u32) -> Vec3 {
        phase.scatter(direction.to_array(), bits).into()
    }

    const GS: [f64; 7] = [-0.9, -0.3, 0.0, 1e-4, 0.4, 0.8, 0.97];

    /// The mean over the cells' midpoints is an integral, not an estimate: it needs no tolerance for noise.
    #[test]
    fn mean_cosine_is_that_of_the_function() {
        let lobes = GS.into_iter().map(henyey_greenstein).chain(TWO_LOBES.into_iter().map(two_lobes));
        for function in lobes.chain([table()]) {
            let phase = PhaseSampler::new(&function);
            let cosine = |i: u32| f64::from(phase.cosine::<f32>(i << 16));
            let mean = (0..1 << 16).map(cosine).sum::<f64>() / f64::from(1 << 16);
            assert!((mean - function.mean_cosine()).abs() < 3e-6, "{function:?}: {mean}");
        }
    }

    /// χ² over 50 cells with 400,000 samples at the 1e-4 level; a shift of g by 0.01, of the second lobe's weight by 0.01
    /// and of its anisotropy by 0.05 fails it.
    #[test]
    fn sampled_cosines_follow_the_density() {
        let chi = |sampled: &PhaseFunction, truth: &PhaseFunction| {
            let phase = PhaseSampler::new(sampled);
            let mut counts = [0_u64; 50];
            for walk in 0..400_000 {
                let bits = Stream::new([7, 11], 0, walk).words()[0];
                let cell = (f64::from(phase.cosine::<f32>(bits)) + 1.0) * 25.0;
                counts[(cell as usize).min(49)] += 1;
            }
            let expected = |i: usize| {
                let sub = |k: usize| -1.0 + (i as f64 + (k as f64 + 0.5) / 200.0) / 25.0;
                (0..200).map(|k| truth.density(sub(k))).sum::<f64>() / 5000.0 * std::f64::consts::TAU
            };
            chi_square(&counts, &(0..50).map(expected).collect::<Vec<_>>())
        };
        let lobes = [-0.3, 0.0, 0.4, 0.8]
            .into_iter()
            .map(|g| (henyey_greenstein(g), vec![henyey_greenstein(g + 0.01)]));
        let shifted = |[g, b, g2]: [f64; 3]| {
            let others = [[g + 0.01, b, g2], [g, b - 0.01, g2], [g, b, g2 + 0.05]];
            (two_lobes([g, b, g2]), others.map(two_lobes).to_vec())
        };
        let two = TWO_LOBES.into_iter().map(shifted);
        for (function, others) in lobes.chain(two).chain([(table(), vec![henyey_greenstein(0.3)])]) {
            let p = chi(&function, &function);
            assert!(p > 1e-4, "{function:?}: p = {p}");
            for other in others {
                assert!(chi(&function, &other) < 1e-4, "{function:?} must differ from {other:?}");
            }
        }
    }

    /// A second lobe of little weight changes cosines by little, but for those of the lobe itself: walks in scenes that
    /// differ by the weight stay alike.
    #[test]
    fn light_second_lobe_changes_few_cosines() {
        let [plain, light] =
            [henyey_greenstein(0.4), two_lobes([0.4, 0.01, -0.5])].map(|f| PhaseSampler::new(&f));
        let off = |i: u32| (plain.cosine::<f32>(i << 16) - light.cosine::<f32>(i << 16)).abs();
        let alike = (0..1_u32 << 16).filter(|i| off(*i) < 0.05).count();
        assert!(alike > 62_000, "{alike}");
    }

    /// A hundred thousand scatterings in a row, without normalisation.
    #[test]
    fn directions_stay_unit_vectors() {
        for g in [-0.6, 0.0, 0.6, 0.95, 0.999] {
            let phase = PhaseSampler::new(&henyey_greenstein(g));
            let mut direction = Vec3::new(0.0, 0.0, -1.0);
            let mut stream = Stream::new([3, 5], 1, 0);
            for _ in 0..100_000 {
                let bits = stream.words()[0];
                let scattered = scatter(&phase, direction, bits);
                let length = scattered.length();
                assert!((length - 1.0).abs() < 2e-5, "g {g}: length {length}");
                let cos: f32 = phase.cosine(bits);
                assert!((scattered.dot(direction) - cos).abs() < 5e-5, "g {g}");
                direction = scattered;
            }
        }
    }

    /// The azimuth must be even about the old direction, whichever way that points: the mean of the part across
    /// it is 0. 40,000 samples, so that an error of 0.02 fails.
    #[test]
    fn scattering_is_even_about_the_old_direction() {
        let phase = PhaseSampler::new(&henyey_greenstein(0.3));
        for n in [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::new(0.6, -0.48, -0.64), Vec3::new(-0.48, 0.64, 0.6)] {
            let axis = n.any_orthonormal_vector();
            let (mut sum, mut squares) = (Vec3::ZERO, 0.0);
            for walk in 0..40_000 {
                let v = scatter(&phase, n, Stream::new([1, 9], 2, walk).words()[0]);
                let across = v - n * v.dot(n);
                sum += across;
                // Along one axis of the plane across n lies half of the square.
                squares += across.dot(axis).powi(2) / across.length_squared();
            }
            assert!(sum.length() / 40_000.0 < 0.015, "{n}: {sum}");
            assert!((squares / 40_000.0 - 0.5).abs() < 0.01, "{n}: {squares}");
        }
    }
}
