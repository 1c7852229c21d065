//! Describes profiles by a few numbers that bound their distances from below, so that a search can skip most records.
//!
//! With an orthonormal basis of a few directions, f = m + Σ c_k φ_k + ρ with ρ orthogonal to all φ_k, and
//!
//! ‖f − f'‖² = Σ (c_k − c'_k)² + ‖ρ − ρ'‖² ≥ Σ (c_k − c'_k)² + (‖ρ‖ − ‖ρ'‖)².
//!
//! The bound holds for any basis; it is tight for one that contains most of the profiles' variation.

use std::borrow::Cow;

use rayon::prelude::*;

use crate::dictionary::sum::{dot, dots, mean};
use crate::dictionary::wide::wide;

/// Maximum number of directions of a basis. More make the bound tighter and slower to compute.
const DIRECTIONS: usize = 16;

/// Relative rounding error that is allowed for in single precision.
const ROUNDING: f32 = 1e-5;

/// An orthonormal basis about a mean profile.
#[derive(Debug)]
pub(crate) struct Basis {
    mean: Vec<f64>,
    directions: Vec<Vec<f64>>,
}

impl Basis {
    /// Gram–Schmidt with pivoting: the sample that the basis describes worst gives the next direction.
    pub(crate) fn of(samples: &[&[f32]]) -> Self {
        let n = samples.first().map_or(0, |s| s.len());
        let mut mean = vec![0.0; n];
        for sample in samples {
            for (m, v) in mean.iter_mut().zip(*sample) {
                *m += f64::from(*v) / samples.len() as f64;
            }
        }
        let centred = |s: &&[f32]| s.iter().zip(&mean).map(|(v, m)| f64::from(*v) - m).collect::<Vec<_>>();
        let mut rests: Vec<Vec<f64>> = samples.iter().map(centred).collect();
        let mut squares: Vec<f64> = rests.iter().map(|rest| dot(rest, rest)).collect();
        let mut directions: Vec<Vec<f64>> = Vec::new();
        while directions.len() < DIRECTIONS.min(n) {
            let worst = (0..rests.len()).max_by(|a, b| squares[*a].total_cmp(&squares[*b]));
            let Some(direction) = worst.and_then(|worst| orthonormal(&rests[worst], &directions)) else {
                break;
            };
            wide(
                #[inline(always)]
                || {
                    for (rest, square) in rests.iter_mut().zip(&mut squares) {
                        take_off(rest, &direction);
                        *square = dot(rest, rest);
                    }
                },
            );
            directions.push(direction);
        }
        Self { mean, directions }
    }

    /// Coefficients of a profile and the norm of the remainder, both as root mean squares over the pixels.
    pub(crate) fn describe<T: Into<f64> + Copy>(&self, profile: &[T]) -> Description {
        let mut numbers = Vec::with_capacity(self.directions.len() + 1);
        let size = self.describe_into(profile, &mut numbers);
        Description { numbers, size }
    }

    /// Appends the description of a profile and returns the profile's root mean square about the mean of the basis.
    fn describe_into<T: Into<f64> + Copy>(&self, profile: &[T], numbers: &mut Vec<f32>) -> f32 {
        let centred: Vec<f64> = profile.iter().zip(&self.mean).map(|(v, m)| (*v).into() - m).collect();
        let scale = 1.0 / (centred.len() as f64).sqrt();
        let (mut square, mut rest) = (0.0, 0.0);
        wide(
            #[inline(always)]
            || {
                square = dot(&centred, &centred);
                rest = square;
                let mut add = |along: f64| {
                    rest -= along * along;
                    numbers.push((along * scale) as f32);
                };
                let (fours, others) = self.directions.as_chunks::<4>();
                for four in fours {
                    dots(&centred, four.each_ref().map(Vec::as_slice)).into_iter().for_each(&mut add);
                }
                for direction in others {
                    add(dot(&centred, direction));
                }
            },
        );
        numbers.push((rest.max(0.0).sqrt() * scale) as f32);
        (square.sqrt() * scale) as f32
    }

    pub(crate) fn mean(&self) -> &[f64] {
        &self.mean
    }

    pub(crate) fn directions(&self) -> &[Vec<f64>] {
        &self.directions
    }
}

/// A unit vector along the component of `v` that is orthogonal to the directions; none if `v` vanishes.
fn orthonormal(v: &[f64], directions: &[Vec<f64>]) -> Option<Vec<f64>> {
    let mut unit = v.to_vec();
    let norm = dot(&unit, &unit).sqrt();
    if norm < 1e-9 {
        return None;
    }
    for v in &mut unit {
        *v /= norm;
    }
    // Orthogonalised again to all: rounding leaves a component along them, and the bound requires orthogonality.
    for direction in directions {
        take_off(&mut unit, direction);
    }
    let norm = dot(&unit, &unit).sqrt();
    for v in &mut unit {
        *v /= norm;
    }
    Some(unit)
}

/// Removes the component along a unit vector, and returns it.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn take_off(from: &mut [f64], direction: &[f64]) -> f64 {
    let along = dot(from, direction);
    for (v, d) in from.iter_mut().zip(direction) {
        *v -= along * d;
    }
    along
}

/// One profile in a basis.
#[derive(Debug)]
pub(crate) struct Description {
    /// The coefficients, then the norm of the remainder.
    numbers: Vec<f32>,
    size: f32,
}

/// Descriptions of many profiles, coefficient by coefficient.
#[derive(Debug)]
pub(crate) struct Sketch {
    profiles: usize,
    /// `[coefficient][profile]`, the norms of the remainders last.
    rows: Vec<f32>,
    largest: f32,
    /// Least and greatest mean of a profile.
    pub levels: (f64, f64),
}

/// Number of profiles that one thread describes at a time.
const TOGETHER: usize = 256;

/// The levels of an empty set.
const NO_LEVELS: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

/// The range that covers both.
fn together(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0.min(b.0), a.1.max(b.1))
}

impl Sketch {
    /// Bytes of a profile's description.
    pub(crate) const BYTES: usize = (DIRECTIONS + 1) * size_of::<f32>();

    /// Describes the profiles 0 to `profiles` − 1.
    pub(crate) fn new<'a>(
        basis: &Basis,
        profiles: usize,
        profile: impl Fn(usize) -> Cow<'a, [f32]> + Sync,
    ) -> Self {
        let each = basis.directions.len() + 1;
        let described = |first: usize| {
            let count = TOGETHER.min(profiles - first);
            let mut numbers = Vec::with_capacity(count * each);
            let (mut largest, mut levels) = (0.0_f32, NO_LEVELS);
            for number in first..first + count {
                let profile = profile(number);
                largest = largest.max(basis.describe_into(&profile, &mut numbers));
                let mean = mean(&profile);
                levels = together(levels, (mean, mean));
            }
            (numbers, largest, levels)
        };
        let parts: Vec<_> = (0..profiles).into_par_iter().step_by(TOGETHER).map(described).collect();
        let mut rows = Vec::with_capacity(profiles * each);
        for k in 0..each {
            for (part, ..) in &parts {
                rows.extend(part.iter().skip(k).step_by(each));
            }
        }
        Self {
            profiles,
            rows,
            largest: parts.iter().map(|(_, largest, _)| *largest).fold(0.0, f32::max),
            levels: parts.iter().map(|(.., levels)| *levels).fold(NO_LEVELS, together),
        }
    }

    /// A coefficient of all profiles, as a root mean square over the pixels.
    pub(crate) fn row(&self, coefficient: usize) -> &[f32] {
        &self.rows[coefficient * self.profiles..][..self.profiles]
    }

    /// Adds `weight` times a lower bound of the root mean square distance between the target and each of the
    /// profiles from `first` on.
    #[inline(always)]
    pub(crate) fn add_bounds(&self, target: &Description, weight: f32, first: usize, bounds: &mut [f32]) {
        const BLOCK: usize = 256;
        let slack = ROUNDING * (target.size + self.largest);
        let mut squares = [0.0_f32; BLOCK];
        for (block, bounds) in bounds.chunks_mut(BLOCK).enumerate() {
            let start = first + block * BLOCK;
            let squares = &mut squares[..bounds.len()];
            squares.fill(0.0);
            for (row, target) in self.rows.chunks_exact(self.profiles.max(1)).zip(&target.numbers) {
                for (square, c) in squares.iter_mut().zip(&row[start..]) {
                    *square += (c - target) * (c - target);
                }
            }
            for (bound, square) in bounds.iter_mut().zip(squares) {
                *bound += weight * (square.sqrt() * (1.0 - ROUNDING) - slack).max(0.0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dictionary::sum::rms_difference;

    /// Profiles with structure and noise.
    fn profiles(count: usize) -> Vec<Vec<f32>> {
        let value = |i: usize, x: usize| {
            let (a, w) = (0.1 + (i % 7) as f32 * 0.1, 2.0 + (i % 11) as f32);
            a + 0.2 * libm::tanhf((x as f32 - 30.0) / w)
                + 1e-3 * ((i * 7919 + x * 104_729) % 97) as f32 / 97.0
        };
        (0..count).map(|i| (0..60).map(|x| value(i, x)).collect()).collect()
    }

    /// Lower bounds never exceed the distance, and are close to it.
    #[test]
    fn bounds_stay_below_the_distance() {
        let profiles = profiles(300);
        let rows: Vec<&[f32]> = profiles.iter().map(Vec::as_slice).collect();
        let basis = Basis::of(&rows[..100]);
        let sketch = Sketch::new(&basis, rows.len(), |i| Cow::Borrowed(rows[i]));
        // Profiles of the basis, and the mean, have no remainder: there rounding matters most.
        let near = |i: usize| profiles[i].iter().map(|v| f64::from(*v) + if *v > 0.2 { 1e-7 } else { 0.0 });
        for target in (0..100).map(|i| near(i).collect::<Vec<f64>>()).chain([basis.mean().to_vec()]) {
            let mut bounds = vec![0.0; 300];
            sketch.add_bounds(&basis.describe(&target), 1.0, 0, &mut bounds);
            for (bound, profile) in bounds.iter().zip(&profiles) {
                assert!(f64::from(*bound) <= rms_difference(&target, profile), "{bound}");
            }
        }
        let mut ratios = Vec::new();
        for target in profiles.iter().step_by(13) {
            let target: Vec<f64> = target.iter().map(|v| 1.01 * f64::from(*v)).collect();
            let mut bounds = vec![0.0; 290];
            sketch.add_bounds(&basis.describe(&target), 1.0, 10, &mut bounds);
            for (bound, profile) in bounds.iter().zip(&profiles[10..]) {
                let distance = rms_difference(&target, profile);
                assert!(f64::from(*bound) <= distance, "{bound} {distance}");
                ratios.push(f64::from(*bound) / distance);
            }
        }
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        assert!(mean > 0.95, "{mean}");
    }
}
