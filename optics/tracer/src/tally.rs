//! From vertices to profiles: difference arrays, batches, and sums in a fixed order.
//!
//! A walk that meets the base at offsets d₁ … d_m before it is connected with the light contributes, as a function of the
//! entry position X, a staircase with steps at X = −dᵢ. The tally holds the *steps*, split between two neighbouring cells so
//! that the average over each pixel is exact, and integrates at the end.
//!
//! Nothing but the base tells left from right, so the mirror image of a walk is as likely as the walk: both are scored.
//! That makes profiles less noisy near the edge, and their gradients more so.
//!
//! Steps are held by number of scatterings ([`crate::scatterings`]), not by albedo: what a vertex costs does not depend on
//! how many albedos there are.

#![expect(
    clippy::inline_always,
    reason = "what is not inlined is not compiled for the instruction set that was chosen at run time"
)]

use fearless_simd::{ExtractToken, Simd, SimdBase, f64x8};
use optics_model::grid::BATCH_WALKS;
use optics_model::job::JobSpec;
use optics_model::scene::Sensor;
use optics_model::sums::{Sums, quantities};

use super::exits::Exit;
use super::light::Light;
use super::pick::{AT_BASE, STEP};
use super::scatterings::{GrowingPowers, NodePowers, WINDOW, count, shares, single};

/// Steps of a chunk of walks.
#[derive(Debug)]
pub struct Tally<'a> {
    job: &'a JobSpec,
    light: &'a Light,
    sensor: Sensor,
    powers: &'a NodePowers,
    nodes: usize,
    /// Per channel: powers of ρ_light and ρ_dark, and their difference.
    reflectances: Vec<(GrowingPowers, GrowingPowers, f64)>,
    /// What steps are weighted with: 1, and the length in the sample if derivatives are wanted.
    moments: usize,
    /// `[cell][channel][moment][node]`, with one cell more than pixels.
    steps: Vec<f64>,
    /// Positions of a walk's steps in pixels from the left end.
    positions: Vec<f64>,
    /// Pixels that show the spread of batches, see [`observed`].
    observed: Vec<usize>,
    /// What they showed up to the last batch, what batches added up to, and their squares: `[pixel][column]`.
    before: Vec<f32>,
    sums: Vec<f64>,
    squares: Vec<f64>,
    batches: u64,
}

impl<'a> Tally<'a> {
    /// For vertices of at most so many scatterings.
    pub fn new(job: &'a JobSpec, light: &'a Light, powers: &'a NodePowers, most: u32) -> Self {
        let sensor = job.scene().sensor();
        let channels = job.scene().channels();
        let nodes = count(most);
        let moments = if job.derivatives() { 2 } else { 1 };
        let observed = observed(sensor.pixels());
        let shown = observed.len() * channels.len() * quantities(job) * job.albedo().len();
        Self {
            job,
            light,
            sensor,
            powers,
            nodes,
            reflectances: channels
                .iter()
                .map(|c| {
                    let powers = (GrowingPowers::new(c.rho_light()), GrowingPowers::new(c.rho_dark()));
                    (powers.0, powers.1, c.rho_light() - c.rho_dark())
                })
                .collect(),
            moments,
            steps: vec![0.0; (sensor.pixels() + 1) * channels.len() * moments * nodes],
            positions: Vec::new(),
            observed,
            before: vec![0.0; shown],
            sums: vec![0.0; shown],
            squares: vec![0.0; shown],
            batches: 0,
        }
    }

    /// Adds the exits of a batch's walks.
    #[inline(always)]
    pub fn add_batch<'b, S: Simd>(&mut self, simd: S, exits: impl Iterator<Item = Exit<'b>>) {
        for exit in exits {
            self.add(simd, &exit);
        }
        self.end_batch(simd);
    }

    /// Adds an exit and its mirror image, which is just as likely, with half the weight each.
    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, exit: &Exit<'_>) {
        let pick = &exit.pick;
        let (receives, light_mm) =
            if pick.z_mm == AT_BASE { self.light.at_base() } else { self.light.at(pick.z_mm, pick.u) };
        let step = f64::from(STEP * self.light.measure);
        let weight = 0.5 * f64::from(pick.cuts) * step * receives / f64::from(pick.worth);
        let (first, shares) = shares(pick.scatterings);
        let weights = shares.map(|share| share * weight);
        let weights = f64x8::from_slice(simd, &weights);
        let length_mm = pick.length_mm + light_mm;
        let (pitch, half) = (self.sensor.pitch_mm(), 0.5 * self.sensor.width_mm());
        self.positions.clear();
        self.positions.extend(exit.hits_mm.iter().map(|&d| (half - f64::from(d)) / pitch));
        self.positions.sort_unstable_by(f64::total_cmp);
        self.add_staircase(first, weights, length_mm);
        // The mirror image: from the right end, the last first.
        let pixels = self.sensor.pixels() as f64;
        self.positions.reverse();
        self.positions.iter_mut().for_each(|p| *p = pixels - *p);
        self.add_staircase(first, weights, length_mm);
    }

    #[inline(always)]
    fn add_staircase<S: Simd>(&mut self, first: usize, weights: f64x8<S>, length_mm: f32) {
        let pixels = self.sensor.pixels() as f64;
        let hits = self.positions.len();
        let left = self.positions.iter().take_while(|&&p| p <= 0.0).count();
        for channel in 0..self.reflectances.len() {
            let (light, dark, _) = &mut self.reflectances[channel];
            let value = light.get(left) * dark.get(hits - left);
            self.add_step(0, channel, value, first, weights, length_mm);
        }
        for k in left..hits {
            let position = self.positions[k];
            if position >= pixels {
                break;
            }
            let cell = position as usize;
            let fraction = position - cell as f64;
            for channel in 0..self.reflectances.len() {
                let (light, dark, contrast) = &mut self.reflectances[channel];
                // ρ_light^(k+1) ρ_dark^(m−k−1) − ρ_light^k ρ_dark^(m−k), exactly 0 without contrast.
                let step = light.get(k) * dark.get(hits - k - 1) * *contrast;
                self.add_step(cell, channel, step * (1.0 - fraction), first, weights, length_mm);
                self.add_step(cell + 1, channel, step * fraction, first, weights, length_mm);
            }
        }
    }

    #[inline(always)]
    fn add_step<S: Simd>(
        &mut self,
        cell: usize,
        channel: usize,
        step: f64,
        first: usize,
        weights: f64x8<S>,
        length_mm: f32,
    ) {
        if step == 0.0 {
            return;
        }
        let row = (cell * self.reflectances.len() + channel) * self.moments;
        let mut step = step;
        for moment in 0..self.moments {
            let at = (row + moment) * self.nodes + first;
            let sums = &mut self.steps[at..at + WINDOW];
            (f64x8::from_slice(weights.token(), sums) + weights * step).store_slice(sums);
            step *= f64::from(length_mm);
        }
    }

    /// Numbers of a pixel: every channel's quantities for every albedo.
    fn columns(&self) -> usize {
        self.reflectances.len() * quantities(self.job) * self.job.albedo().len()
    }

    /// What nodes hold, turned into a pixel's columns.
    #[inline(always)]
    fn tell<S: Simd>(&self, simd: S, level: &[f64], out: &mut [f32]) {
        let (nodes, albedos) = (self.nodes, self.job.albedo().len());
        let rows = level
            .chunks_exact(nodes * self.moments)
            .zip(out.chunks_exact_mut(quantities(self.job) * albedos));
        let mut held = vec![0.0; nodes];
        for (level, row) in rows {
            held.iter_mut().zip(level).for_each(|(held, level)| *held = single(*level));
            let (values, derivatives) = row.split_at_mut(albedos);
            self.powers.sum(simd, &held, values);
            if !derivatives.is_empty() {
                let (d_albedo, d_sigma_t) = derivatives.split_at_mut(albedos);
                self.powers.sum_derivatives(simd, &held, d_albedo);
                // n/σ_t − L.
                let (sums, lengths) = level.split_at(nodes);
                let sigma_t = self.job.point().sigma_t_per_mm();
                for (((held, sum), length), n) in
                    held.iter_mut().zip(sums).zip(lengths).zip(self.powers.numbers())
                {
                    *held = single(sum * n / sigma_t - length);
                }
                self.powers.sum(simd, &held, d_sigma_t);
            }
        }
    }

    /// Looks at what the batch has added to the observed pixels.
    #[inline(always)]
    fn end_batch<S: Simd>(&mut self, simd: S) {
        let columns = self.columns();
        let row = self.reflectances.len() * self.moments * self.nodes;
        let mut level = vec![0.0; row];
        let mut shown = vec![0.0; columns];
        let mut at = 0;
        for (cell, steps) in self.steps.chunks_exact(row).enumerate() {
            level.iter_mut().zip(steps).for_each(|(level, step)| *level += step);
            if self.observed.get(at) != Some(&cell) {
                continue;
            }
            self.tell(simd, &level, &mut shown);
            let places = at * columns..(at + 1) * columns;
            let sums = self.sums[places.clone()].iter_mut().zip(&mut self.squares[places.clone()]);
            for ((shown, before), (sum, square)) in shown.iter().zip(&mut self.before[places]).zip(sums) {
                let added = f64::from(shown - *before);
                *before = *shown;
                *sum += added;
                *square += added * added;
            }
            at += 1;
        }
        self.batches += 1;
    }

    /// What the batches add up to, and how far they spread.
    #[inline(always)]
    pub fn end<S: Simd>(&mut self, simd: S, total: &mut Sums) {
        let columns = self.columns();
        let row = self.reflectances.len() * self.moments * self.nodes;
        let mut level = vec![0.0; row];
        let mut shown = vec![0.0; columns];
        let straight = self.straight();
        for (steps, sums) in self.steps.chunks_exact(row).zip(total.sums.chunks_exact_mut(columns)) {
            level.iter_mut().zip(steps).for_each(|(level, step)| *level += step);
            self.tell(simd, &level, &mut shown);
            for ((sum, shown), straight) in sums.iter_mut().zip(&shown).zip(&straight) {
                *sum += f64::from(*shown) + straight;
            }
        }
        let batches = self.batches as f64;
        let deviation = |at: usize| (self.squares[at] - self.sums[at] * self.sums[at] / batches).max(0.0);
        let deviations = total.deviations.chunks_exact_mut(columns);
        let mut at = 0;
        for (pixel, deviations) in deviations.enumerate() {
            while at + 1 < self.observed.len() && self.observed[at + 1] <= pixel {
                at += 1;
            }
            let next = (at + 1).min(self.observed.len() - 1);
            let between = (self.observed[next] - self.observed[at]).max(1) as f64;
            let share = (pixel - self.observed[at]) as f64 / between;
            for (column, sum) in deviations.iter_mut().enumerate() {
                let [a, b] = [at, next].map(|place| deviation(place * columns + column));
                *sum += a + share * (b - a);
            }
        }
        total.add_batches(self.batches);
    }

    /// What light that meets interfaces only adds to every pixel.
    fn straight(&self) -> Vec<f64> {
        let walks = (self.batches * BATCH_WALKS) as f64;
        let albedos = self.job.albedo().len();
        let mut quantity = vec![self.light.straight * walks; albedos];
        if self.job.derivatives() {
            quantity.extend(std::iter::repeat_n(0.0, albedos));
            quantity.extend(std::iter::repeat_n(-self.light.straight_mm * walks, albedos));
        }
        quantity.repeat(self.reflectances.len())
    }
}

/// Pixels that show how far batches spread, the first and the last among them. In between, the spread is interpolated:
/// it is smooth, but near the edge.
fn observed(pixels: usize) -> Vec<usize> {
    let mut observed = Vec::new();
    let mut pixel = 0;
    while pixel + 1 < pixels {
        observed.push(pixel);
        let from_edge = (2 * pixel + 1).abs_diff(pixels) / 2;
        let step = match from_edge {
            0..6 => 1,
            6..20 => 2,
            20..60 => 4,
            _ => 12,
        };
        // Not over the fine ones near the edge.
        let next = pixel + step;
        let fine = (pixels / 2).saturating_sub(6);
        pixel = if pixel < fine && next > fine { fine } else { next };
    }
    observed.push(pixels - 1);
    observed
}
