//! Accumulates profiles from vertices: difference arrays, batches, and sums in a fixed order.
//!
//! A walk that meets the base at offsets d₁ … d_m before it is connected with the light contributes, as a function of the
//! entry position X, a staircase with steps at X = −dᵢ. The tally holds the *steps*, split between two neighbouring cells so
//! that the average over each pixel is exact, and integrates at the end.
//!
//! Where light spreads within the base, it crosses the ink twice: as it enters and as it leaves. These are two hits, of √ρ
//! each.
//!
//! Over a uniform base the staircase is flat: its height by the number of hits gives the levels that a profile reaches far
//! from the edge.
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

mod base;
mod spread;

use fearless_simd::{ExtractToken, Simd, SimdBase, f32x8};
use optics_model::controls::Controls;
use optics_model::grid::BATCH_WALKS;
use optics_model::job::JobSpec;
use optics_model::scene::{Channel, Sensor};
use optics_model::sums::{Sums, quantities};

use super::exits::Offset;
use super::light::Light;
use super::scatterings::{NodePowers, WINDOW, count};
use super::vertex::{Vertex, Vertices};
use base::{Base, DARK, LIGHT, flush};
use spread::{Spread, WalkLevels};

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
    albedos: &'a Albedos,
    /// Hits of all vertices.
    hits: &'a [Offset],
    nodes: usize,
    base: Vec<Base>,
    /// Number of weights of a step: 1, and the length in the sample, in mean free paths, if derivatives are requested.
    moments: usize,
    /// `[cell][channel][moment][node]`, with one cell more than pixels.
    steps: Vec<f32>,
    /// Sums of walks with few hits, by their number: `[hits][moment][node]`.
    by_hits: Vec<f32>,
    /// Sums of the others, weighted as over uniform bases: `[side][channel][moment][node]`.
    many_hits: [Vec<f32>; 2],
    /// Positions of a walk's steps in pixels from the left end.
    positions: Vec<f32>,
    /// Levels at the controls up to the last batch: `[side][channel][control]`.
    controls: Vec<f32>,
    spread: Spread,
}

/// Albedos at which steps are summed: those of the job, and those of its controls.
#[derive(Debug)]
pub struct Albedos {
    powers: NodePowers,
    controls: Controls,
    control_powers: NodePowers,
}

impl Albedos {
    /// For walks of up to `most` scatterings.
    pub fn new(job: &JobSpec, controls: Controls, most: u32) -> Self {
        let [powers, control_powers] =
            [job.albedo(), controls.albedos()].map(|albedos| NodePowers::new(albedos, most));
        Self { powers, controls, control_powers }
    }
}

impl<'a> Tally<'a> {
    /// For these vertices.
    pub fn new(
        job: &'a JobSpec,
        light: &'a Light,
        albedos: &'a Albedos,
        hits: &'a [Offset],
        vertices: &Vertices,
    ) -> Self {
        let sensor = job.scene().sensor();
        let channels = job.scene().channels();
        let nodes = count(vertices.most_scatterings);
        let moments = if job.derivatives() { 2 } else { 1 };
        let columns = channels.len() * quantities(job) * job.albedo().len();
        let level_len = channels.len() * moments * nodes;
        let most_hits = vertices.most_hits as usize;
        let px_per_mm = 1.0 / sensor.pitch_mm();
        let crossings = if job.scene().base_spread_mm() > 0.0 { 2 } else { 1 };
        let base = |c: &Channel| Base::new([c.rho_light(), c.rho_dark()], crossings, most_hits);
        Self {
            job,
            light,
            sensor,
            free_path_px: (px_per_mm / job.point().sigma_t_per_mm()) as f32,
            mm_px: px_per_mm as f32,
            edge_px: (0.5 * sensor.width_mm() * px_per_mm) as f32,
            albedos,
            hits,
            nodes,
            base: channels.iter().map(base).collect(),
            moments,
            steps: vec![0.0; (sensor.pixels() + 1) * channels.len() * moments * nodes],
            by_hits: vec![0.0; (most_hits.min(FEW_HITS) + 1) * moments * nodes],
            many_hits: [0, 1].map(|_| vec![0.0; level_len]),
            positions: Vec::new(),
            controls: vec![0.0; 2 * channels.len() * albedos.controls.albedos().len()],
            spread: Spread::new(sensor.pixels(), columns),
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
        if hits <= FEW_HITS {
            let at = hits * self.moments * self.nodes + vertex.first_node as usize;
            add(&mut self.by_hits, at, self.nodes, self.moments, weights, vertex.length);
        } else {
            for channel in 0..self.base.len() {
                let at = channel * self.moments * self.nodes + vertex.first_node as usize;
                for (side, level) in self.many_hits.iter_mut().enumerate() {
                    let value = self.base[channel].uniform(side, hits);
                    add(level, at, self.nodes, self.moments, weights * value, vertex.length);
                }
            }
        }
        if left + right > 0 {
            // In the first pixel some of its hits are light.
            for channel in 0..self.base.len() {
                let base = &self.base[channel];
                let value = base.weight(left, hits - left) + base.weight(right, hits - right);
                let value = value - base.uniform(DARK, hits);
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

    /// Sum over all walks, and over their mirror images, over a base that is light or dark everywhere:
    /// `[channel][moment][node]`.
    fn uniform(&self, side: usize) -> Vec<f32> {
        let of_one = self.moments * self.nodes;
        let mut level = self.many_hits[side].clone();
        for (base, level) in self.base.iter().zip(level.chunks_exact_mut(of_one)) {
            for (hits, sum) in self.by_hits.chunks_exact(of_one).enumerate() {
                let weight = base.uniform(side, hits);
                level.iter_mut().zip(sum).for_each(|(level, sum)| *level += weight * sum);
            }
        }
        level
    }

    /// Levels at the controls: `[channel][control]`.
    #[inline(always)]
    fn at_controls<S: Simd>(&self, simd: S, level: &[f32]) -> Vec<f32> {
        let mut levels = vec![0.0; self.base.len() * self.albedos.controls.albedos().len()];
        self.sum_radiance(simd, level, &self.albedos.control_powers, &mut levels);
        levels
    }

    /// Radiances of the contents of nodes, for every channel and albedo of `powers`.
    #[inline(always)]
    fn sum_radiance<S: Simd>(&self, simd: S, level: &[f32], powers: &NodePowers, out: &mut [f32]) {
        let albedos = out.len() / self.base.len();
        if albedos > 0 {
            let rows = level.chunks_exact(self.nodes * self.moments);
            for (level, out) in rows.zip(out.chunks_exact_mut(albedos)) {
                powers.sum(simd, &level[..self.nodes], out);
            }
        }
    }

    /// Numbers of a pixel: every channel's quantities for every albedo.
    fn columns(&self) -> usize {
        self.base.len() * quantities(self.job) * self.job.albedo().len()
    }

    /// Converts the contents of nodes to a pixel's columns.
    #[inline(always)]
    fn fill_columns<S: Simd>(&self, simd: S, level: &[f32], out: &mut [f32]) {
        let (nodes, albedos) = (self.nodes, self.job.albedo().len());
        let rows = level
            .chunks_exact(nodes * self.moments)
            .zip(out.chunks_exact_mut(quantities(self.job) * albedos));
        for (level, row) in rows {
            let (values, derivatives) = row.split_at_mut(albedos);
            self.albedos.powers.sum(simd, &level[..nodes], values);
            if !derivatives.is_empty() {
                let (d_albedo, d_sigma_t) = derivatives.split_at_mut(albedos);
                let (sums, lengths) = level.split_at(nodes);
                self.albedos.powers.sum_derivatives(simd, sums, d_albedo);
                // n/σ_t − L, L being a length in mm.
                let free_path = self.mean_free_path_mm() as f32;
                let numbers = sums.iter().zip(lengths).zip(self.albedos.powers.numbers());
                let held: Vec<f32> =
                    numbers.map(|((sum, length), n)| flush((sum * *n as f32 - length) * free_path)).collect();
                self.albedos.powers.sum(simd, &held, d_sigma_t);
            }
        }
    }

    /// Records the contribution of the batch to the observed pixels.
    #[inline(always)]
    fn end_batch<S: Simd>(&mut self, simd: S) {
        let mut level = self.uniform(DARK);
        let [dark, contrast] = self.batch_levels(simd, &level);
        let row = level.len();
        let mut shown = vec![0.0; self.columns()];
        let mut at = 0;
        for (cell, steps) in self.steps.chunks_exact(row).enumerate() {
            level.iter_mut().zip(steps).for_each(|(level, step)| *level += step);
            if self.spread.pixel(at) == Some(cell) {
                self.fill_columns(simd, &level, &mut shown);
                self.spread.add(at, &shown, &dark, &contrast);
                at += 1;
            }
        }
        self.spread.end_batch(&contrast);
    }

    /// By column, the dark level of the last batch by the controls, and the light one's difference from it; 0 for
    /// derivatives. `dark` is the level of all batches so far.
    #[inline(always)]
    fn batch_levels<S: Simd>(&mut self, simd: S, dark: &[f32]) -> [Vec<f64>; 2] {
        let columns = self.columns();
        let mut levels = [vec![0.0; columns], vec![0.0; columns]];
        let controls = &self.albedos.controls;
        if controls.is_empty() {
            return levels;
        }
        let mut now = self.at_controls(simd, &self.uniform(LIGHT));
        now.extend(self.at_controls(simd, dark));
        let added = now.iter().zip(&self.controls).map(|(now, before)| f64::from(now - before));
        let added: Vec<f64> = added.collect();
        self.controls = now;
        let (albedos, count) = (self.job.albedo().len(), controls.albedos().len());
        for channel in 0..self.base.len() {
            let level = |side: usize| &added[(side * self.base.len() + channel) * count..][..count];
            for albedo in 0..albedos {
                let column = channel * quantities(self.job) * albedos + albedo;
                let [light, dark] = [LIGHT, DARK].map(|side| controls.at(albedo, level(side)));
                (levels[0][column], levels[1][column]) = (dark, light - dark);
            }
        }
        levels
    }

    /// Adds the sums of the batches and their spread to `total`.
    #[inline(always)]
    pub fn end<S: Simd>(&mut self, simd: S, total: &mut Sums) {
        let columns = self.columns();
        let mut level = self.uniform(DARK);
        let own = self.end_levels(simd, &level, total);
        let row = level.len();
        let mut shown = vec![0.0; columns];
        let straight = self.straight();
        for (steps, sums) in self.steps.chunks_exact(row).zip(total.sums.chunks_exact_mut(columns)) {
            level.iter_mut().zip(steps).for_each(|(level, step)| *level += step);
            self.fill_columns(simd, &level, &mut shown);
            for ((sum, shown), straight) in sums.iter_mut().zip(&shown).zip(&straight) {
                *sum += f64::from(*shown) + straight;
            }
        }
        self.spread.add_deviations(&own, &mut total.deviations);
        total.add_batches(self.spread.batches());
    }

    /// Adds the levels of all batches to `total`, and returns those of its albedos; 0 in columns without controls.
    #[inline(always)]
    fn end_levels<S: Simd>(&self, simd: S, dark: &[f32], total: &mut Sums) -> WalkLevels {
        let (channels, albedos) = (self.base.len(), self.job.albedo().len());
        let controls = self.albedos.controls.albedos().len();
        let mut levels = WalkLevels { dark: vec![0.0; self.columns()], contrast: vec![0.0; self.columns()] };
        if controls == 0 {
            return levels;
        }
        let straight = self.light.straight * self.walks();
        let mut own = [LIGHT, DARK].map(|_| vec![0.0; channels * albedos]);
        self.sum_radiance(simd, &self.uniform(LIGHT), &self.albedos.powers, &mut own[LIGHT]);
        self.sum_radiance(simd, dark, &self.albedos.powers, &mut own[DARK]);
        let rows = own.iter().flat_map(|own| own.chunks_exact(albedos));
        let rows = rows.zip(self.controls.chunks_exact(controls));
        for (sums, (own, at_controls)) in total.levels.chunks_exact_mut(albedos + controls).zip(rows) {
            let added = own.iter().chain(at_controls);
            sums.iter_mut().zip(added).for_each(|(sum, added)| *sum += f64::from(*added) + straight);
        }
        for (i, (light, dark)) in own[LIGHT].iter().zip(&own[DARK]).enumerate() {
            let column = i / albedos * quantities(self.job) * albedos + i % albedos;
            (levels.dark[column], levels.contrast[column]) = (*dark, light - dark);
        }
        levels
    }

    /// Number of walks of all batches.
    fn walks(&self) -> f64 {
        (self.spread.batches() * BATCH_WALKS) as f64
    }

    /// Contribution to every pixel of light that meets interfaces only.
    fn straight(&self) -> Vec<f64> {
        let (walks, albedos) = (self.walks(), self.job.albedo().len());
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
