//! From walks to profiles: difference arrays, batches, and sums in a fixed order.
//!
//! A walk that meets the base at offsets d₁ … d_m before it meets the light contributes, as a function of the entry
//! position X, a staircase with steps at X = −dᵢ. The tally holds the *steps*, split between two neighbouring cells so that the average
//! over each pixel is exact, and integrates once per batch.
//!
//! Nothing but the base tells left from right, so the mirror image of a walk is as likely as the walk: both are scored.
//! That makes profiles less noisy near the edge, and their gradients more so.

#![expect(
    clippy::inline_always,
    reason = "what is not inlined is not compiled for the instruction set that was chosen at run time"
)]

use std::ops::Range;

use optics_model::job::JobSpec;
use optics_model::scene::Sensor;
use optics_model::sums::{Sums, quantities};

use super::exits::{Albedos, Exit};
use super::pick::{GROUPS, REFERENCES, members};
use super::powers::{AlbedoPowers, GrowingPowers};

/// Columns come in blocks of so many: whole registers, whatever the machine.
const BLOCK: usize = 16;

/// Steps of one batch of walks: `[cell][channel][group][quantity][albedo]`, with one cell more than pixels. A group's
/// albedos are filled up to whole blocks.
#[derive(Debug)]
pub struct Tally<'a> {
    job: &'a JobSpec,
    sensor: Sensor,
    groups: &'a [Group; GROUPS],
    /// Per channel: powers of ρ_light and ρ_dark, and their difference.
    reflectances: Vec<(GrowingPowers, GrowingPowers, f64)>,
    columns: usize,
    /// In single precision: a batch's walks are few, and memory is what scoring waits for.
    steps: Vec<f32>,
    /// Weight of the exit at hand in every column.
    weights: Vec<f32>,
    exact: Vec<f64>,
    /// Positions of the walk's steps in pixels from the left end.
    positions: Vec<f64>,
}

/// A group of albedos, ready to be scored.
#[derive(Debug)]
pub struct Group {
    /// Indices of its albedos.
    members: Vec<usize>,
    reference: f64,
    /// Of α/α_ref.
    powers: AlbedoPowers,
    /// Its columns, a quantity after the other.
    first: usize,
    width: usize,
    quantities: usize,
}

impl Group {
    pub fn all(job: &JobSpec) -> [Self; GROUPS] {
        let mut first = 0;
        let quantities = quantities(job);
        let mut next = 0;
        members(job.albedo()).map(|members| {
            let reference = f64::from(REFERENCES[next]);
            next += 1;
            let width = members.len().next_multiple_of(BLOCK);
            let mut ratios = vec![0.0; width];
            ratios.iter_mut().zip(&members).for_each(|(r, i)| *r = job.albedo()[*i] / reference);
            let group = Self { members, reference, powers: AlbedoPowers::new(&ratios), first, width, quantities };
            first += width * quantities;
            group
        })
    }

    fn columns(&self) -> Range<usize> {
        self.first..self.first + self.width * self.quantities
    }
}

impl<'a> Tally<'a> {
    pub fn new(job: &'a JobSpec, groups: &'a [Group; GROUPS]) -> Self {
        let sensor = job.scene().sensor();
        let channels = job.scene().channels();
        let columns = groups[GROUPS - 1].columns().end;
        Self {
            job,
            sensor,
            groups,
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
            exact: vec![0.0; columns],
            positions: Vec::new(),
        }
    }

    /// Adds the exits of a batch's walks, and the batch to `partial`.
    #[inline(always)]
    pub fn add_batch<'b>(&mut self, exits: impl Iterator<Item = Exit<'b>>, partial: &mut Sums) {
        for exit in exits {
            self.add(&exit);
        }
        self.finish_batch(partial);
    }

    /// Adds an exit and its mirror image, which is just as likely, with half the weight each.
    #[inline(always)]
    fn add(&mut self, exit: &Exit<'_>) {
        let columns = match exit.albedos {
            Albedos::All => {
                (0..GROUPS).for_each(|group| self.weigh(exit, group));
                0..self.columns
            }
            Albedos::Group(group) => {
                self.weigh(exit, group);
                self.groups[group].columns()
            }
        };
        if columns.is_empty() {
            return;
        }
        let (pitch, half) = (self.sensor.pitch_mm(), 0.5 * self.sensor.width_mm());
        self.positions.clear();
        self.positions.extend(exit.hits_mm.iter().map(|&d| (half - f64::from(d)) / pitch));
        self.positions.sort_unstable_by(f64::total_cmp);
        self.add_staircase(columns.clone());
        // The mirror image: from the right end, the last first.
        let pixels = self.sensor.pixels() as f64;
        self.positions.reverse();
        self.positions.iter_mut().for_each(|p| *p = pixels - *p);
        self.add_staircase(columns);
    }

    #[inline(always)]
    fn add_staircase(&mut self, columns: Range<usize>) {
        let pixels = self.sensor.pixels() as f64;
        let left = self.positions.iter().take_while(|&&p| p <= 0.0).count();
        let hits = self.positions.len();
        for channel in 0..self.reflectances.len() {
            let (light, dark, _) = &mut self.reflectances[channel];
            let value = light.get(left) * dark.get(hits - left);
            self.add_step(0, channel, value, columns.clone());
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
                self.add_step(cell, channel, step * (1.0 - fraction), columns.clone());
                self.add_step(cell + 1, channel, step * fraction, columns.clone());
            }
        }
    }

    /// α^n, n α^(n−1) and (n/σ_t − L) α^n, times half the exit's weight, for a group's albedos.
    #[inline(always)]
    fn weigh(&mut self, exit: &Exit<'_>, group: usize) {
        let group = &self.groups[group];
        let columns = group.columns();
        let (n, weight) = (exit.scatterings, 0.5 * exit.weight);
        let exact = &mut self.exact[columns.clone()];
        let (values, derivatives) = exact.split_at_mut(group.width);
        group.powers.write(n, weight, values);
        if !derivatives.is_empty() {
            let (d_albedo, d_sigma_t) = derivatives.split_at_mut(group.width);
            let slope = weight * f64::from(n) / group.reference;
            group.powers.write(n.saturating_sub(1), slope, d_albedo);
            let score = f64::from(n) / self.job.point().sigma_t_per_mm() - f64::from(exit.length_mm);
            for (d, value) in d_sigma_t.iter_mut().zip(values) {
                *d = score * *value;
            }
        }
        self.weights[columns].iter_mut().zip(exact).for_each(|(w, e)| *w = single(*e));
    }

    #[inline(always)]
    fn add_step(&mut self, cell: usize, channel: usize, step: f64, columns: Range<usize>) {
        let step = single(step);
        if step == 0.0 {
            return;
        }
        let row = (cell * self.reflectances.len() + channel) * self.columns;
        let sums = self.steps[row..][..self.columns][columns.clone()].chunks_exact_mut(BLOCK);
        for (sums, weights) in sums.zip(self.weights[columns].chunks_exact(BLOCK)) {
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum += step * weight;
            }
        }
    }

    /// Integrates the steps to profiles, adds them to `partial` as one batch, and starts afresh.
    #[inline(always)]
    fn finish_batch(&mut self, partial: &mut Sums) {
        let albedos = self.job.albedo().len();
        let channels = self.reflectances.len();
        let row = channels * self.columns;
        let sums_row = channels * quantities(self.job) * albedos;
        let mut level = vec![0.0; row];
        let cells = self.steps.chunks_exact_mut(row);
        let sums = partial.sums.chunks_exact_mut(sums_row).zip(partial.squares.chunks_exact_mut(sums_row));
        for (cell, (sums, squares)) in cells.zip(sums) {
            for (level, step) in level.iter_mut().zip(cell) {
                *level += f64::from(*step);
                *step = 0.0;
            }
            for channel in 0..channels {
                for group in self.groups {
                    for quantity in 0..group.quantities {
                        let from = channel * self.columns + group.first + quantity * group.width;
                        let to = (channel * group.quantities + quantity) * albedos;
                        for (level, member) in level[from..].iter().zip(&group.members) {
                            sums[to + member] += level;
                            squares[to + member] += level * level;
                        }
                    }
                }
            }
        }
        let beyond = self.steps.len() - row;
        self.steps[beyond..].fill(0.0);
        partial.batch_added();
    }
}

/// In single precision; what is so small that it would be slow is 0.
#[inline(always)]
fn single(x: f64) -> f32 {
    if x.abs() < 1e-18 { 0.0 } else { x as f32 }
}
