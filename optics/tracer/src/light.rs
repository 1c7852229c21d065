//! Computes the light that a walk's vertex receives straight from the ring, without another vertex between.
//!
//! Between the ring and the first diffuse vertex – a scattering, or a hit on the base – light meets interfaces only.
//! Followed from the ring ([`Arrivals`]), it crosses the sample in beams: a polar cosine μ, a face at which the beam
//! begins, and a flux w, the share of the ring's light. All is symmetric about the normal, so a scattering at the
//! optical depth d of a walk that flies with the cosine u receives the radiance factor
//!
//! C(d, u) = π/n² Σ w/μ · p̄(u, μ) · e^(−d/μ),
//!
//! n being the sample's index and p̄ the phase function averaged over the azimuth; for beams that begin at the lower
//! face, d is the height above it. Lengths in the sample are in mean free paths. A hit on the base receives w_b/n_c²,
//! w_b being the flux that reaches the base and n_c the index above it. Values are multiplied by the ring's measure.
//!
//! [`Light::about`] approximates C cheaply; vertices are picked by it. [`Light::at`] is C itself, by cubics between
//! nodes, and corrects for the approximation.

#![expect(
    clippy::inline_always,
    reason = "what is not inlined is not compiled for the instruction set that was chosen at run time"
)]

mod arrivals;

use std::f64::consts::{LN_2, PI};

use optics_model::phase::PhaseFunction;

use super::math::{exp_f64, power_of_two};
use super::stack::Stack;
use arrivals::{Arrivals, Beam};

/// Cells of [`Light::about`] over the cosine.
pub const CELLS: usize = 16;
/// Optical depth, to base 2, from which [`Light::about`] neglects light that goes up.
const THICK: f64 = 8.0;
/// Steps of the table over the depth.
const DEPTHS: usize = 96;
/// Least and greatest steps of the table over the cosine.
const COSINES: (usize, usize) = (96, 1 << 15);
/// Optical depth beyond which light straight from the ring is negligible: e⁻⁴⁰.
const DARK: f64 = 40.0;

/// The light that the vertices of walks receive.
#[derive(Debug)]
pub struct Light {
    /// Values of [`Light::about`] for light that goes down and up; whether the sample is so thick that only the first
    /// counts.
    pub down: [f32; CELLS],
    pub up: [f32; CELLS],
    pub thick: bool,
    /// Logarithms to base 2 by which light fades: over a mean free path, and through the whole sample.
    pub fading: f32,
    pub faded: f32,
    /// Light that a hit on the base receives.
    pub base: f32,
    /// Light from the ring to the sensor that meets interfaces only, and the same times its length in the sample.
    pub straight: f64,
    pub straight_length: f64,
    /// The ring's measure, see [`optics_model::scene::RingLight`].
    pub measure: f32,
    /// Mean length in the sample of the light that reaches the base, in mean free paths.
    base_length: f64,
    thickness: f32,
    inverse_reach: f32,
    steps: usize,
    /// C: `[depth][cosine]`, at steps of both that lie close at the ends.
    table: Vec<f64>,
    /// C times the mean length of its light in the sample, if derivatives are requested.
    lengths: Option<Vec<f64>>,
}

/// Flux of beams after attenuation over the length that they have passed in the sample, and the same times this length.
fn total(beams: &[Beam], thickness: f64) -> [f64; 2] {
    beams.iter().fold([0.0; 2], |[sum, lengths], beam| {
        let length = thickness * beam.passed;
        let flux = beam.flux * exp_f64(-length);
        [sum + flux, lengths + flux * length]
    })
}

/// Azimuthal means of the phase function for these cosines of walks and one of a beam.
#[inline(always)]
fn means_of(scattering: &PhaseFunction, cosines: &[f64], beam: f64, means: &mut [f64]) {
    const LANES: usize = 8;
    for (u, means) in cosines.chunks(LANES).zip(means.chunks_mut(LANES)) {
        let lanes = std::array::from_fn(|i| u[i.min(u.len() - 1)]);
        means.copy_from_slice(&scattering.azimuthal_means::<LANES>(lanes, beam)[..u.len()]);
    }
}

impl Light {
    /// For walks through a stack. The loops are plain; where it is inlined the compiler may use this machine's vectors.
    #[inline(always)]
    pub fn new(stack: &Stack, derivatives: bool) -> Self {
        let arrivals = Arrivals::of(stack);
        let [inner, outer] = stack.ring_sin2.map(|s| f64::from(s).clamp(0.0, 1.0));
        let measure = outer - inner;
        let (n, n_c) = (stack.iors[stack.sample], stack.iors[stack.iors.len() - 1]);
        let thickness = f64::from(stack.thickness[stack.sample]);
        let scattering = stack.phase.function();
        let scale = PI * measure / (n * n);
        let reach = thickness.min(DARK);
        let steps = ((32.0 / scattering.peak_width()) as usize).clamp(COSINES.0, COSINES.1);
        let mut table = vec![0.0; (DEPTHS + 1) * (steps + 1)];
        let mut lengths = derivatives.then(|| table.clone());
        let cosines: Vec<f64> = (0..=steps).map(|k| number_at(k, steps)).collect();
        // Many points in each cell, so that the peak of a narrow phase function is not missed.
        let each = steps.div_ceil(CELLS).max(4);
        let in_cell = |k: usize| (2 * k + 1) as f64 / (each * CELLS) as f64 - 1.0;
        let in_cells =
            [1.0, -1.0].map(|sign| (0..each * CELLS).map(|k| sign * in_cell(k)).collect::<Vec<_>>());
        let (mut phase, mut of_cells) = (cosines.clone(), in_cells[0].clone());
        let mut about = [[0.0; CELLS]; 2];
        let mut entering = [0.0; 2];
        for beam in &arrivals.in_sample(thickness, scattering) {
            let flux = scale * beam.flux / beam.cosine;
            means_of(scattering, &cosines, beam.cosine, &mut phase);
            // Light that goes up has the values of light that goes down, with the signs of the cosines changed.
            if !beam.down {
                phase.reverse();
            }
            for (i, row) in table.chunks_exact_mut(steps + 1).enumerate() {
                let depth = 0.5 * reach * (1.0 + number_at(i, DEPTHS));
                let length = if beam.down { depth } else { thickness - depth } / beam.cosine;
                let factor = flux * exp_f64(-length);
                row.iter_mut().zip(&phase).for_each(|(c, p)| *c += factor * p);
                if let Some(lengths) = &mut lengths {
                    let row = &mut lengths[i * (steps + 1)..][..=steps];
                    let length = thickness * beam.passed + length;
                    row.iter_mut().zip(&phase).for_each(|(c, p)| *c += factor * length * p);
                }
            }
            means_of(scattering, &in_cells[usize::from(!beam.down)], beam.cosine, &mut of_cells);
            for (k, phase) in of_cells.iter().enumerate() {
                about[usize::from(!beam.down)][k / each] += flux * phase / each as f64;
            }
            if beam.down {
                entering = [entering[0] + flux, entering[1] + flux * beam.cosine];
            }
        }
        let mean_cosine = if entering[0] > 0.0 { entering[1] / entering[0] } else { 1.0 };
        let fading = 1.0 / (LN_2 * mean_cosine);
        let [down, up] = about.map(|values| values.map(|v| v as f32));
        let [base, base_lengths] = total(&arrivals.base, thickness);
        let [straight, straight_length] = total(&arrivals.ring, thickness);
        Self {
            down,
            up,
            thick: fading * thickness > THICK,
            fading: fading as f32,
            faded: (fading * thickness) as f32,
            base: (base * measure / (n_c * n_c)) as f32,
            straight,
            straight_length,
            measure: measure as f32,
            base_length: if base > 0.0 { base_lengths / base } else { 0.0 },
            thickness: thickness as f32,
            inverse_reach: (1.0 / reach) as f32,
            steps,
            table,
            lengths,
        }
    }

    /// Approximates the light that a scattering at a height receives, for a walk that arrives with the cosine `u`.
    pub fn about(&self, z: f32, u: f32) -> f32 {
        let cell = (((u + 1.0) * (0.5 * CELLS as f32)).max(0.0) as usize).min(CELLS - 1);
        let height = z * self.fading;
        let down = self.down[cell] * power_of_two(height - self.faded);
        if self.thick { down } else { down + self.up[cell] * power_of_two(-height) }
    }

    /// C at a height, and the mean length of its light in the sample (0 unless derivatives are requested).
    pub fn at(&self, z: f32, u: f32) -> (f64, f32) {
        let depth = ((self.thickness - z) * self.inverse_reach).max(0.0);
        if depth > 1.0 {
            return (0.0, 0.0);
        }
        let place = |x: f32, steps: usize| {
            // At the ends all four nodes lie on one side.
            let first = (x as usize).clamp(1, steps - 2) - 1;
            (first, cubic(f64::from(x - first as f32) - 1.0))
        };
        let (row, by_depth) = place((place_of(2.0 * depth - 1.0) + 1.0) * (0.5 * DEPTHS as f32), DEPTHS);
        let (column, by_cosine) = place((place_of(u) + 1.0) * (0.5 * self.steps as f32), self.steps);
        let first = row * (self.steps + 1) + column;
        let value = |table: &[f64]| -> f64 {
            let row = |i: usize| {
                let nodes = &table[first + i * (self.steps + 1)..][..4];
                let [a, b, c, d] = by_cosine;
                a * nodes[0] + b * nodes[1] + (c * nodes[2] + d * nodes[3])
            };
            let [a, b, c, d] = by_depth;
            a * row(0) + b * row(1) + (c * row(2) + d * row(3))
        };
        let c = value(&self.table).max(0.0);
        let length = self.lengths.as_ref().filter(|_| c > 0.0).map_or(0.0, |lengths| value(lengths) / c);
        (c, length as f32)
    }

    /// C at a hit on the base, and the mean length of its light in the sample (0 unless derivatives are requested).
    pub fn at_base(&self) -> (f64, f32) {
        (f64::from(self.base), if self.lengths.is_some() { self.base_length as f32 } else { 0.0 })
    }
}

/// Number in (−1, 1) at a step of the table. Steps lie close at the ends, where light changes fast with depth and cosine:
/// x = ±(1 − √(1 − |u|)).
fn number_at(k: usize, steps: usize) -> f64 {
    let x = 2.0 * k as f64 / steps as f64 - 1.0;
    (1.0 - (1.0 - x.abs()).powi(2)).copysign(x)
}

/// Its inverse: x.
fn place_of(u: f32) -> f32 {
    (1.0 - (1.0 - u.abs()).max(0.0).sqrt()).copysign(u)
}

/// Weights of four nodes at −1, 0, 1 and 2: the cubic through them.
fn cubic(x: f64) -> [f64; 4] {
    let (a, b, c) = (x + 1.0, x - 1.0, x - 2.0);
    [-x * b * c / 6.0, a * b * c / 2.0, -a * x * c / 2.0, a * x * b / 6.0]
}

#[cfg(test)]
mod tests;
