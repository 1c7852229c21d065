//! From walks to profiles: difference arrays, batches, and sums in a fixed order.
//!
//! A walk that meets the base at offsets d₁ … d_m contributes, as a function of the entry position X, a staircase
//! with steps at X = −dᵢ. The tally holds the *steps*, split between two neighbouring cells so that the average
//! over each pixel is exact, and integrates once per batch.
//!
//! Nothing but the base tells left from right, so the mirror image of a walk is as likely as the walk: both are scored.
//! That makes profiles less noisy near the edge, and their gradients more so.

#![expect(
    clippy::inline_always,
    reason = "what is not inlined is not compiled for the instruction set that was chosen at run time"
)]

use optics_model::job::JobSpec;
use optics_model::scene::Sensor;
use optics_model::sums::{Sums, quantities};

use super::exits::Exit;
use super::powers::{AlbedoPowers, GrowingPowers};

/// Steps of one batch of walks: `[cell][channel][quantity][albedo]`, with one cell more than pixels.
#[derive(Debug)]
pub struct Tally<'a> {
    job: &'a JobSpec,
    sensor: Sensor,
    powers: &'a AlbedoPowers,
    /// Per channel: powers of ρ_light and ρ_dark, and their difference.
    reflectances: Vec<(GrowingPowers, GrowingPowers, f64)>,
    columns: usize,
    steps: Vec<f64>,
    /// Weight of the walk at hand for every quantity and albedo.
    weights: Vec<f64>,
    /// Positions of the walk's steps in pixels from the left end.
    positions: Vec<f64>,
}

impl<'a> Tally<'a> {
    pub fn new(job: &'a JobSpec, powers: &'a AlbedoPowers) -> Self {
        let sensor = job.scene().sensor();
        let channels = job.scene().channels();
        let columns = quantities(job) * job.albedo().len();
        Self {
            job,
            sensor,
            powers,
            reflectances: channels
                .iter()
                .map(|c| {
                    let powers = (GrowingPowers::new(c.rho_light()), GrowingPowers::new(c.rho_dark()));
                    (powers.0, powers.1, c.rho_light() - c.rho_dark())
                })
                .collect(),
            columns,
            steps: vec![0.0; (sensor.pixels() + 1) * channels.len() * columns],
            weights: vec![0.0; columns],
            positions: Vec::new(),
        }
    }

    /// Adds the walks of a batch that have left into the ring, and the batch to `partial`.
    #[inline(always)]
    pub fn add_batch<'b>(&mut self, exits: impl Iterator<Item = Exit<'b>>, partial: &mut Sums) {
        for exit in exits {
            self.add(&exit);
        }
        self.finish_batch(partial);
    }

    /// Adds a walk and its mirror image, which is just as likely, with half the weight each.
    #[inline(always)]
    fn add(&mut self, exit: &Exit<'_>) {
        self.weigh(exit);
        for side in [1.0, -1.0] {
            self.add_staircase(side, exit.hits_mm);
        }
    }

    #[inline(always)]
    fn add_staircase(&mut self, side: f64, hits_mm: &[f32]) {
        let (pitch, half) = (self.sensor.pitch_mm(), 0.5 * self.sensor.width_mm());
        let pixels = self.sensor.pixels() as f64;
        self.positions.clear();
        self.positions.extend(hits_mm.iter().map(|&d| (half - side * f64::from(d)) / pitch));
        self.positions.sort_unstable_by(f64::total_cmp);
        let left = self.positions.partition_point(|&p| p <= 0.0);
        let inside = self.positions.partition_point(|&p| p < pixels);
        let hits = hits_mm.len();
        for channel in 0..self.reflectances.len() {
            let (light, dark, _) = &mut self.reflectances[channel];
            let value = light.get(left) * dark.get(hits - left);
            self.add_step(0, channel, value);
        }
        for k in left..inside {
            let cell = self.positions[k] as usize;
            let fraction = self.positions[k] - cell as f64;
            for channel in 0..self.reflectances.len() {
                let (light, dark, contrast) = &mut self.reflectances[channel];
                // ρ_light^(k+1) ρ_dark^(m−k−1) − ρ_light^k ρ_dark^(m−k), exactly 0 without contrast.
                let step = light.get(k) * dark.get(hits - k - 1) * *contrast;
                self.add_step(cell, channel, step * (1.0 - fraction));
                self.add_step(cell + 1, channel, step * fraction);
            }
        }
    }

    /// α^n, n α^(n−1) and (n/σ_t − L) α^n, times half the walk's weight.
    #[inline(always)]
    fn weigh(&mut self, exit: &Exit<'_>) {
        let albedos = self.job.albedo().len();
        let (n, weight) = (exit.scatterings, 0.5 * f64::from(exit.weight));
        let (values, derivatives) = self.weights.split_at_mut(albedos);
        self.powers.write(n, weight, values);
        if !derivatives.is_empty() {
            let (d_albedo, d_sigma_t) = derivatives.split_at_mut(albedos);
            self.powers.write(n.saturating_sub(1), weight * f64::from(n), d_albedo);
            let score = f64::from(n) / self.job.point().sigma_t_per_mm() - f64::from(exit.length_mm);
            for (d, value) in d_sigma_t.iter_mut().zip(values) {
                *d = score * *value;
            }
        }
    }

    #[inline(always)]
    fn add_step(&mut self, cell: usize, channel: usize, step: f64) {
        let row = (cell * self.reflectances.len() + channel) * self.columns;
        if step != 0.0 {
            for (sum, weight) in self.steps[row..][..self.columns].iter_mut().zip(&self.weights) {
                *sum += step * weight;
            }
        }
    }

    /// Integrates the steps to profiles, adds them to `partial` as one batch, and starts afresh.
    #[inline(always)]
    fn finish_batch(&mut self, partial: &mut Sums) {
        let row = self.reflectances.len() * self.columns;
        let mut level = vec![0.0; row];
        let cells = self.steps.chunks_exact_mut(row);
        let sums = partial.sums.chunks_exact_mut(row).zip(partial.squares.chunks_exact_mut(row));
        for (cell, (sum, square)) in cells.zip(sums) {
            for (((level, step), sum), square) in level.iter_mut().zip(cell).zip(sum).zip(square) {
                *level += *step;
                *step = 0.0;
                *sum += *level;
                *square += *level * *level;
            }
        }
        let beyond = self.steps.len() - row;
        self.steps[beyond..].fill(0.0);
        partial.batch_added();
    }
}
