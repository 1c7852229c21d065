//! Light that comes straight from the ring: what a walk's vertex receives without another one between.
//!
//! Between the ring and the first diffuse vertex – a scattering, or a hit on the base – light meets interfaces only.
//! Followed from the ring ([`segments`]), it crosses the sample in segments: a polar cosine μ, a face at which the segment
//! begins, and a flux w, the share of the ring's light. Nothing tells azimuths apart, so a scattering at the depth d of a
//! walk that flies with the cosine u receives the radiance factor
//!
//! C(d, u) = π/n² Σ w/μ · p̄(u, μ) · e^(−σ_t d/μ),
//!
//! n being the sample's index and p̄ the phase function averaged over the azimuth; for segments that begin at the lower
//! face, d is the height above it. A hit on the base receives w_b/n_c², w_b being the flux that comes to the base and n_c
//! the index above it. Values are multiplied by the ring's measure, as are the weights of walks that leave into it.
//!
//! [`Light::about`] is cheap and near C; vertices are chosen by it. [`Light::at`] is C itself, by cubics between nodes, and
//! corrects for it.

mod phase;
mod segments;

use std::f64::consts::{LN_2, PI};

use optics_model::job::JobSpec;
use optics_model::scene::sin2;

use super::math::power_of_two;
use super::stack::Stack;
use phase::mean_phase;
use segments::{Segments, exp};

/// Nodes of [`Light::about`] over the cosine.
pub const NODES: usize = 16;
/// Steps of the table over the depth.
const DEPTHS: usize = 96;
/// Least and greatest steps of the table over the cosine.
const COSINES: (usize, usize) = (96, 1024);
/// Optical depth below which nothing comes straight from the ring: e⁻⁴⁰.
const DARK: f64 = 40.0;

/// What the vertices of walks receive.
#[derive(Debug)]
pub struct Light {
    /// Values of [`Light::about`] at its nodes for light that goes down and up, and their steps to the next node.
    pub down: [[f32; NODES]; 2],
    pub up: [[f32; NODES]; 2],
    /// Logarithms to base 2 by which light fades: a mm, and through the whole sample.
    pub fading: f32,
    pub faded: f32,
    /// What a hit on the base receives.
    pub base: f32,
    /// Mean length in the sample of the light that comes to the base.
    base_length_mm: f64,
    thickness_mm: f32,
    inverse_reach: f32,
    steps: usize,
    /// C: `[depth][cosine]`, at depths (i/DEPTHS)² of the reach.
    table: Vec<f64>,
    /// C times the mean length of its light in the sample, if derivatives are wanted.
    lengths: Option<Vec<f64>>,
}

impl Light {
    /// For a job's walks through its stack.
    pub fn of(job: &JobSpec, stack: &Stack) -> Self {
        let ring = job.scene().light();
        Self::new(stack, [ring.inner_deg(), ring.outer_deg()].map(sin2), job.derivatives())
    }

    pub fn new(stack: &Stack, ring_sin2: [f64; 2], derivatives: bool) -> Self {
        let segments = Segments::follow(stack, ring_sin2);
        let measure = ring_sin2[1] - ring_sin2[0];
        let (n, n_c) = (stack.iors[stack.sample], stack.iors[stack.iors.len() - 1]);
        let thickness = f64::from(stack.thickness_mm[stack.sample]);
        let sigma_t = 1.0 / f64::from(stack.mean_free_path_mm);
        let g = f64::from(stack.phase.g);
        let scale = PI * measure / (n * n);
        let reach = thickness.min(DARK / sigma_t);
        let steps = ((32.0 / (1.0 - g.abs())) as usize).clamp(COSINES.0, COSINES.1);
        let cosine = |k: usize, steps: usize| -1.0 + 2.0 * k as f64 / steps as f64;
        let mut table = vec![0.0; (DEPTHS + 1) * (steps + 1)];
        let mut lengths = derivatives.then(|| table.clone());
        let mut about = [[0.0; NODES]; 2];
        for ray in segments.rays() {
            // For light that goes up the same, with the cosines' signs changed.
            let mirrored = |k: usize, steps: usize| if ray.down { k } else { steps - k };
            let phase: Vec<f64> =
                (0..=steps).map(|k| mean_phase(g, cosine(mirrored(k, steps), steps), ray.cosine)).collect();
            for (i, row) in table.chunks_exact_mut(steps + 1).enumerate() {
                let depth = reach * (i as f64 / DEPTHS as f64).powi(2);
                let length = if ray.down { depth } else { thickness - depth } / ray.cosine;
                let factor = scale * ray.flux / ray.cosine * exp(-sigma_t * length);
                row.iter_mut().zip(&phase).for_each(|(c, p)| *c += factor * p);
                if let Some(lengths) = &mut lengths {
                    let row = &mut lengths[i * (steps + 1)..][..steps + 1];
                    row.iter_mut().zip(&phase).for_each(|(c, p)| *c += factor * length * p);
                }
            }
            for (k, value) in about[usize::from(!ray.down)].iter_mut().enumerate() {
                let u = cosine(mirrored(k, NODES - 1), NODES - 1);
                *value += scale * ray.flux / ray.cosine * mean_phase(g, u, ray.cosine);
            }
        }
        let fading = sigma_t / (LN_2 * segments.mean_cosine());
        let [down, up] = about.map(with_steps);
        Self {
            down,
            up,
            fading: fading as f32,
            faded: (fading * thickness) as f32,
            base: (segments.base * measure / (n_c * n_c)) as f32,
            base_length_mm: segments.base_length_mm(),
            thickness_mm: thickness as f32,
            inverse_reach: (1.0 / reach) as f32,
            steps,
            table,
            lengths,
        }
    }

    /// Near what a scattering at a height receives, for a walk that comes with the cosine `u`.
    pub fn about(&self, z_mm: f32, u: f32) -> f32 {
        let x = ((u + 1.0) * (0.5 * (NODES - 1) as f32)).max(0.0).min((NODES - 1) as f32 - 0.001);
        let node = x as i32;
        let beyond = x - node as f32;
        let node = node as usize;
        let down = self.down[0][node] + self.down[1][node] * beyond;
        let up = self.up[0][node] + self.up[1][node] * beyond;
        let height = z_mm * self.fading;
        down * power_of_two(height - self.faded) + up * power_of_two(-height)
    }

    /// C at a height, and the mean length of its light in the sample (0 unless derivatives are wanted).
    pub fn at(&self, z_mm: f32, u: f32) -> (f64, f32) {
        let depth = ((self.thickness_mm - z_mm) * self.inverse_reach).max(0.0);
        if depth > 1.0 {
            return (0.0, 0.0);
        }
        let place = |x: f32, steps: usize| {
            // At the ends all four nodes lie on one side.
            let first = (x as usize).clamp(1, steps - 2) - 1;
            (first, cubic(f64::from(x - first as f32) - 1.0))
        };
        let (row, by_depth) = place(depth.sqrt() * DEPTHS as f32, DEPTHS);
        let (column, by_cosine) = place((u + 1.0).clamp(0.0, 2.0) * (0.5 * self.steps as f32), self.steps);
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

    /// The same for a hit on the base.
    pub fn at_base(&self) -> (f64, f32) {
        (f64::from(self.base), if self.lengths.is_some() { self.base_length_mm as f32 } else { 0.0 })
    }
}

fn with_steps(values: [f64; NODES]) -> [[f32; NODES]; 2] {
    let mut steps = [0.0; NODES];
    for (step, pair) in steps.iter_mut().zip(values.windows(2)) {
        *step = (pair[1] - pair[0]) as f32;
    }
    [values.map(|v| v as f32), steps]
}

/// Weights of four nodes at −1, 0, 1 and 2: the cubic through them.
fn cubic(x: f64) -> [f64; 4] {
    let (a, b, c) = (x + 1.0, x - 1.0, x - 2.0);
    [-x * b * c / 6.0, a * b * c / 2.0, -a * x * c / 2.0, a * x * b / 6.0]
}

#[cfg(test)]
mod tests;
