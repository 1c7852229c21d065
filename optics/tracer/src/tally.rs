//! Accumulates profiles from vertices: difference arrays, batches, and sums in a fixed order.
//!
//! A walk that meets the base at offsets d₁ … d_m before it is connected with the light contributes, as a function of the
//! entry position X, a staircase with steps at X = −dᵢ. The tally holds the *steps*, split between two neighbouring cells so
//! that the average over each pixel is exact, and integrates at the end.
//!
//! Only the base breaks the symmetry of left and right, so the mirror image of a walk is as likely as the walk: both
//! are scored. This reduces the noise of profiles near the edge, and that of their gradients even more.
//!
//! Steps are held by number of scatterings ([`crate::scatterings`]), not by albedo: the cost of a vertex does not depend
//! on the number of albedos.

#![expect(
    clippy::inline_always,
    reason = "what is not inlined is not compiled for the instruction set that was chosen at run time"
)]

use fearless_simd::{ExtractToken, Simd, SimdBase, f32x8};
use optics_model::grid::BATCH_WALKS;
use optics_model::job::JobSpec;
use optics_model::scene::Sensor;
use optics_model::sums::{Sums, quantities};

use super::exits::Offset;
use super::light::Light;
use super::scatterings::{NodePowers, WINDOW, count, single};
use super::vertex::{Vertex, Vertices};

/// Number of hits on the base that most walks stay below. Behind very thick samples there may be thousands.
const FEW_HITS: usize = 64;

/// Steps of a chunk of walks.
#[derive(Debug)]
pub struct Tally<'a> {
    job: &'a JobSpec,
    light: &'a Light,
    sensor: Sensor,
    /// Pixels to a mean free path and to a mm, and the place of the edge.
    free_path_px: f32,
    mm_px: f32,
    edge_px: f32,
    powers: &'a NodePowers,
    /// Hits of all vertices.
    hits: &'a [Offset],
    nodes: usize,
    base: Vec<Base>,
    /// Number of weights of a step: 1, and the length in the sample, in mean free paths, if derivatives are requested.
    moments: usize,
    /// `[cell][channel][moment][node]`, with one cell more than pixels.
    steps: Vec<f32>,
    /// Sums of walks whose hits are few and all in view, by their number: `[hits][moment][node]`. Left of the view all of
    /// them are dark, whatever the channel.
    dark: Vec<f32>,
    /// Positions of a walk's steps in pixels from the left end.
    positions: Vec<f32>,
    /// Pixels at which the spread of batches is observed, see [`observed`].
    observed: Vec<usize>,
    /// Their values up to the last batch, and the sums of the batches' contributions and of the squares of these:
    /// `[pixel][column]`.
    before: Vec<f32>,
    sums: Vec<f64>,
    squares: Vec<f64>,
    batches: u64,
}

/// The base in one channel: powers of its reflectances for numbers of hits, and the difference of the reflectances.
#[derive(Debug)]
struct Base {
    light: Vec<f32>,
    dark: Vec<f32>,
    contrast: f32,
}

impl Base {
    fn new(rho_light: f64, rho_dark: f64, most_hits: usize) -> Self {
        let powers = |rho: f64| {
            let next = move |power: &f64| Some(power * rho);
            std::iter::successors(Some(1.0), next).take(most_hits + 1).map(single).collect()
        };
        Self { light: powers(rho_light), dark: powers(rho_dark), contrast: (rho_light - rho_dark) as f32 }
    }

    /// ρ_light^a ρ_dark^b.
    fn weight(&self, a: usize, b: usize) -> f32 {
        flush(self.light[a] * self.dark[b])
    }

    /// Change of the weight by a hit that turns light where a others are light and b dark: exactly 0 without contrast.
    fn step(&self, a: usize, b: usize) -> f32 {
        flush(self.light[a] * self.dark[b] * self.contrast)
    }
}

/// Flush to zero: arithmetic with subnormal operands is slow.
fn flush(x: f32) -> f32 {
    if x.abs() < 1e-18 { 0.0 } else { x }
}

impl<'a> Tally<'a> {
    /// For these vertices.
    pub fn new(
        job: &'a JobSpec,
        light: &'a Light,
        powers: &'a NodePowers,
        hits: &'a [Offset],
        vertices: &Vertices,
    ) -> Self {
        let sensor = job.scene().sensor();
        let channels = job.scene().channels();
        let nodes = count(vertices.most_scatterings);
        let moments = if job.derivatives() { 2 } else { 1 };
        let observed = observed(sensor.pixels());
        let shown = observed.len() * channels.len() * quantities(job) * job.albedo().len();
        let most_hits = vertices.most_hits as usize;
        let px_per_mm = 1.0 / sensor.pitch_mm();
        Self {
            job,
            light,
            sensor,
            free_path_px: (px_per_mm / job.point().sigma_t_per_mm()) as f32,
            mm_px: px_per_mm as f32,
            edge_px: (0.5 * sensor.width_mm() * px_per_mm) as f32,
            powers,
            hits,
            nodes,
            base: channels.iter().map(|c| Base::new(c.rho_light(), c.rho_dark(), most_hits)).collect(),
            moments,
            steps: vec![0.0; (sensor.pixels() + 1) * channels.len() * moments * nodes],
            dark: vec![0.0; (most_hits.min(FEW_HITS) + 1) * moments * nodes],
            positions: Vec::new(),
            observed,
            before: vec![0.0; shown],
            sums: vec![0.0; shown],
            squares: vec![0.0; shown],
            batches: 0,
        }
    }

    /// Adds the vertices of a batch's walks.
    #[inline(always)]
    pub fn add_batch<S: Simd>(&mut self, simd: S, vertices: &[Vertex]) {
        for vertex in vertices {
            self.add(simd, vertex);
        }
        self.end_batch(simd);
    }

    /// Adds a vertex and its mirror image, which is just as likely, with half the weight each.
    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, vertex: &Vertex) {
        self.find_positions(vertex.hits(self.hits));
        let pixels = self.sensor.pixels() as f32;
        let hits = self.positions.len();
        let left = self.positions.iter().take_while(|&&p| p <= 0.0).count();
        let right = self.positions.iter().rev().take_while(|&&p| p >= pixels).count();
        let weights = f32x8::from_slice(simd, &vertex.weights);
        if left + right == 0 && hits <= FEW_HITS {
            let at = hits * self.moments * self.nodes + vertex.first_node as usize;
            add(&mut self.dark, at, self.nodes, self.moments, weights, vertex.length);
        } else {
            for channel in 0..self.base.len() {
                let base = &self.base[channel];
                let value = base.weight(left, hits - left) + base.weight(right, hits - right);
                self.add_step(0, channel, weights * value, vertex);
            }
        }
        for k in left..hits - right {
            let position = self.positions[k];
            let cell = position as usize;
            let fraction = position - cell as f32;
            // The mirror image has as many hits to its right, and its steps at the other side.
            let mirrored = self.sensor.pixels() - cell;
            for channel in 0..self.base.len() {
                let base = &self.base[channel];
                if base.contrast == 0.0 {
                    continue;
                }
                let (up, down) = (base.step(k, hits - k - 1), base.step(hits - k - 1, k));
                self.add_step(cell, channel, weights * (up * (1.0 - fraction)), vertex);
                self.add_step(cell + 1, channel, weights * (up * fraction), vertex);
                self.add_step(mirrored - 1, channel, weights * (down * fraction), vertex);
                self.add_step(mirrored, channel, weights * (down * (1.0 - fraction)), vertex);
            }
        }
    }

    /// Finds the positions at which hits make steps, from left to right.
    #[inline(always)]
    fn find_positions(&mut self, hits: &[Offset]) {
        let (free_path, mm, edge) = (self.free_path_px, self.mm_px, self.edge_px);
        let position = |hit: &Offset| edge - (hit.free_paths * free_path + hit.mm * mm);
        self.positions.clear();
        if hits.len() > FEW_HITS {
            self.positions.extend(hits.iter().map(position));
            self.positions.sort_unstable_by(f32::total_cmp);
            return;
        }
        for position in hits.iter().map(position) {
            // Most of them are near the last.
            let place = self.positions.iter().rposition(|p| *p <= position).map_or(0, |last| last + 1);
            self.positions.insert(place, position);
        }
    }

    #[inline(always)]
    fn add_step<S: Simd>(&mut self, cell: usize, channel: usize, weights: f32x8<S>, vertex: &Vertex) {
        let row = (cell * self.base.len() + channel) * self.moments;
        let at = row * self.nodes + vertex.first_node as usize;
        add(&mut self.steps, at, self.nodes, self.moments, weights, vertex.length);
    }

    fn mean_free_path_mm(&self) -> f64 {
        1.0 / self.job.point().sigma_t_per_mm()
    }

    /// Sum over all walks that are dark in the first pixel, and over their mirror images: `[channel][moment][node]`.
    fn beyond(&self) -> Vec<f32> {
        let of_one = self.moments * self.nodes;
        let mut level = vec![0.0; self.base.len() * of_one];
        for (base, level) in self.base.iter().zip(level.chunks_exact_mut(of_one)) {
            for (hits, dark) in self.dark.chunks_exact(of_one).enumerate() {
                let weight = 2.0 * base.weight(0, hits);
                level.iter_mut().zip(dark).for_each(|(level, dark)| *level += weight * dark);
            }
        }
        level
    }

    /// Numbers of a pixel: every channel's quantities for every albedo.
    fn columns(&self) -> usize {
        self.base.len() * quantities(self.job) * self.job.albedo().len()
    }

    /// Converts the contents of nodes to a pixel's columns.
    #[inline(always)]
    fn tell<S: Simd>(&self, simd: S, level: &[f32], out: &mut [f32]) {
        let (nodes, albedos) = (self.nodes, self.job.albedo().len());
        let rows = level
            .chunks_exact(nodes * self.moments)
            .zip(out.chunks_exact_mut(quantities(self.job) * albedos));
        for (level, row) in rows {
            let (values, derivatives) = row.split_at_mut(albedos);
            self.powers.sum(simd, &level[..nodes], values);
            if !derivatives.is_empty() {
                let (d_albedo, d_sigma_t) = derivatives.split_at_mut(albedos);
                let (sums, lengths) = level.split_at(nodes);
                self.powers.sum_derivatives(simd, sums, d_albedo);
                // n/σ_t − L, L being a length in mm.
                let free_path = self.mean_free_path_mm() as f32;
                let numbers = sums.iter().zip(lengths).zip(self.powers.numbers());
                let held: Vec<f32> =
                    numbers.map(|((sum, length), n)| flush((sum * *n as f32 - length) * free_path)).collect();
                self.powers.sum(simd, &held, d_sigma_t);
            }
        }
    }

    /// Records the contribution of the batch to the observed pixels.
    #[inline(always)]
    fn end_batch<S: Simd>(&mut self, simd: S) {
        let columns = self.columns();
        let mut level = self.beyond();
        let row = level.len();
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

    /// Adds the sums of the batches and their spread to `total`.
    #[inline(always)]
    pub fn end<S: Simd>(&mut self, simd: S, total: &mut Sums) {
        let columns = self.columns();
        let mut level = self.beyond();
        let row = level.len();
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

    /// Contribution to every pixel of light that meets interfaces only.
    fn straight(&self) -> Vec<f64> {
        let walks = (self.batches * BATCH_WALKS) as f64;
        let albedos = self.job.albedo().len();
        let mut quantity = vec![self.light.straight * walks; albedos];
        if self.job.derivatives() {
            quantity.extend(std::iter::repeat_n(0.0, albedos));
            let length_mm = self.light.straight_length * self.mean_free_path_mm();
            quantity.extend(std::iter::repeat_n(-length_mm * walks, albedos));
        }
        quantity.repeat(self.base.len())
    }
}

/// Adds weights to a window of nodes, and to that of the lengths behind it if there is one.
#[inline(always)]
fn add<S: Simd>(sums: &mut [f32], at: usize, nodes: usize, moments: usize, weights: f32x8<S>, length: f32) {
    let window = &mut sums[at..at + WINDOW];
    (f32x8::from_slice(weights.token(), window) + weights).store_slice(window);
    if moments == 2 {
        let window = &mut sums[at + nodes..at + nodes + WINDOW];
        (f32x8::from_slice(weights.token(), window) + weights * length).store_slice(window);
    }
}

/// Pixels at which the spread of batches is observed, the first and the last among them. In between, the spread is
/// interpolated: it is smooth except near the edge.
fn observed(pixels: usize) -> Vec<usize> {
    let mut observed = Vec::new();
    let mut pixel = 0;
    while pixel + 1 < pixels {
        observed.push(pixel);
        let from_edge = (2 * pixel + 1).abs_diff(pixels) / 2;
        let step = match from_edge {
            0..4 => 1,
            4..12 => 2,
            12..36 => 6,
            _ => 24,
        };
        // Not over the fine ones near the edge.
        let next = pixel + step;
        let fine = (pixels / 2).saturating_sub(4);
        pixel = if pixel < fine && next > fine { fine } else { next };
    }
    observed.push(pixels - 1);
    observed
}
