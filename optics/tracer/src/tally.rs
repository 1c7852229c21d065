//! Accumulates profiles from vertices: difference arrays, batches, and sums in a fixed order.
//!
//! A walk that meets the base at offsets d₁ … d_m before it is connected with the light contributes, as a function of the
//! entry position X, a staircase with steps at X = −dᵢ. The tally holds the *steps*, split between two neighbouring cells so
//! that the average over each pixel is exact, and integrates at the end.
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

use fearless_simd::{ExtractToken, Simd, SimdBase, f32x8};
use optics_model::controls::Controls;
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
    /// Pixels at which the spread of batches is observed, see [`observed`].
    observed: Vec<usize>,
    /// Their values up to the last batch, by pixel.
    before: Vec<Vec<f32>>,
    /// Levels at the controls up to the last batch: `[side][channel][control]`.
    levels_before: Vec<f32>,
    /// By pixel.
    spread: Vec<Spread>,
    batches: u64,
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

/// Sums over batches of contributions to a pixel, by column: of a = F − C_dark and b = C_light − C_dark, C being the levels
/// by the controls, and of their squares and products. Without controls a is F, and b is 0.
#[derive(Debug, Default, Clone)]
struct Spread {
    a: Vec<f64>,
    b: Vec<f64>,
    aa: Vec<f64>,
    ab: Vec<f64>,
    bb: Vec<f64>,
}

impl Spread {
    fn new(columns: usize) -> Self {
        let [a, b, aa, ab, bb] = std::array::from_fn(|_| vec![0.0; columns]);
        Self { a, b, aa, ab, bb }
    }

    /// Adds a batch's contributions to F, less C_dark, and to C_light − C_dark.
    #[inline(always)]
    fn add(&mut self, added: &[f32], [dark, contrast]: &[Vec<f64>; 2]) {
        let [a, b, aa, ab, bb] = [&mut self.a, &mut self.b, &mut self.aa, &mut self.ab, &mut self.bb];
        let len = added.len();
        let [dark, contrast] = [&dark[..len], &contrast[..len]];
        let [a, b, aa, ab, bb] = [a, b, aa, ab, bb].map(|sums| &mut sums[..len]);
        for i in 0..len {
            let (of_dark, of_contrast) = (f64::from(added[i]) - dark[i], contrast[i]);
            a[i] += of_dark;
            b[i] += of_contrast;
            aa[i] += of_dark * of_dark;
            ab[i] += of_dark * of_contrast;
            bb[i] += of_contrast * of_contrast;
        }
    }

    /// Sum of the squares of the deviations of a − s b from its mean.
    #[inline(always)]
    fn deviation(&self, column: usize, share: f64, batches: f64) -> f64 {
        let [a, b] = [self.a[column], self.b[column]];
        let variance = self.aa[column] - a * a / batches;
        let covariance = self.ab[column] - a * b / batches;
        let of_level = self.bb[column] - b * b / batches;
        (variance - share * (covariance + covariance - share * of_level)).max(0.0)
    }
}

/// Sides of the base.
const LIGHT: usize = 0;
const DARK: usize = 1;

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

    /// Twice the weight of hits over a base that is light or dark everywhere: that of a walk and of its mirror image.
    fn uniform(&self, side: usize, hits: usize) -> f32 {
        2.0 * flush(if side == DARK { self.dark[hits] } else { self.light[hits] })
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
        albedos: &'a Albedos,
        hits: &'a [Offset],
        vertices: &Vertices,
    ) -> Self {
        let sensor = job.scene().sensor();
        let channels = job.scene().channels();
        let nodes = count(vertices.most_scatterings);
        let moments = if job.derivatives() { 2 } else { 1 };
        let observed = observed(sensor.pixels());
        let columns = channels.len() * quantities(job) * job.albedo().len();
        let of_level = channels.len() * moments * nodes;
        let most_hits = vertices.most_hits as usize;
        let px_per_mm = 1.0 / sensor.pitch_mm();
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
            base: channels.iter().map(|c| Base::new(c.rho_light(), c.rho_dark(), most_hits)).collect(),
            moments,
            steps: vec![0.0; (sensor.pixels() + 1) * channels.len() * moments * nodes],
            by_hits: vec![0.0; (most_hits.min(FEW_HITS) + 1) * moments * nodes],
            many_hits: [0, 1].map(|_| vec![0.0; of_level]),
            positions: Vec::new(),
            before: vec![vec![0.0; columns]; observed.len()],
            levels_before: vec![0.0; 2 * channels.len() * albedos.controls.albedos().len()],
            spread: vec![Spread::new(columns); observed.len()],
            observed,
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
    fn tell<S: Simd>(&self, simd: S, level: &[f32], out: &mut [f32]) {
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
        let levels = self.batch_levels(simd, &level);
        let row = level.len();
        let mut shown = vec![0.0; self.columns()];
        let mut at = 0;
        for (cell, steps) in self.steps.chunks_exact(row).enumerate() {
            level.iter_mut().zip(steps).for_each(|(level, step)| *level += step);
            if self.observed.get(at) != Some(&cell) {
                continue;
            }
            self.tell(simd, &level, &mut shown);
            // `before` holds the contribution of this batch for a moment.
            self.before[at].iter_mut().zip(&shown).for_each(|(before, shown)| *before = shown - *before);
            self.spread[at].add(&self.before[at], &levels);
            self.before[at].copy_from_slice(&shown);
            at += 1;
        }
        self.batches += 1;
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
        let added = now.iter().zip(&self.levels_before).map(|(now, before)| f64::from(now - before));
        let added: Vec<f64> = added.collect();
        self.levels_before = now;
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
        let shares = self.end_levels(simd, &level, total);
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
        let observed: Vec<Vec<f64>> = self
            .spread
            .iter()
            .zip(&self.before)
            .map(|(spread, values)| {
                let deviation =
                    |column| spread.deviation(column, shares.share(column, values[column]), batches);
                (0..columns).map(deviation).collect()
            })
            .collect();
        let deviations = total.deviations.chunks_exact_mut(columns);
        let mut at = 0;
        for (pixel, deviations) in deviations.enumerate() {
            while at + 1 < self.observed.len() && self.observed[at + 1] <= pixel {
                at += 1;
            }
            let next = (at + 1).min(self.observed.len() - 1);
            let between = (self.observed[next] - self.observed[at]).max(1) as f64;
            let share = (pixel - self.observed[at]) as f64 / between;
            for (sum, (a, b)) in deviations.iter_mut().zip(observed[at].iter().zip(&observed[next])) {
                *sum += a + share * (b - a);
            }
        }
        total.add_batches(self.batches);
    }

    /// Adds the levels of all batches to `total`.
    #[inline(always)]
    fn end_levels<S: Simd>(&self, simd: S, dark: &[f32], total: &mut Sums) -> Shares {
        let (channels, albedos) = (self.base.len(), self.job.albedo().len());
        let controls = self.albedos.controls.albedos().len();
        let mut shares = Shares { dark: vec![0.0; self.columns()], contrast: vec![0.0; self.columns()] };
        if controls == 0 {
            return shares;
        }
        let straight = self.light.straight * (self.batches * BATCH_WALKS) as f64;
        let mut own = vec![vec![0.0; channels * albedos]; 2];
        for (side, level) in [&self.uniform(LIGHT), dark].into_iter().enumerate() {
            self.sum_radiance(simd, level, &self.albedos.powers, &mut own[side]);
            let at_controls = self.at_controls(simd, level);
            let rows = own[side].chunks_exact(albedos).zip(at_controls.chunks_exact(controls));
            let len = channels * (albedos + controls);
            let sums = total.levels[side * len..][..len].chunks_exact_mut(albedos + controls);
            for (sums, (own, at_controls)) in sums.zip(rows) {
                let added = own.iter().chain(at_controls);
                sums.iter_mut().zip(added).for_each(|(sum, added)| *sum += f64::from(*added) + straight);
            }
        }
        for (i, (light, dark)) in own[LIGHT].iter().zip(&own[DARK]).enumerate() {
            let column = i / albedos * quantities(self.job) * albedos + i % albedos;
            (shares.dark[column], shares.contrast[column]) = (*dark, light - dark);
        }
        shares
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

/// The levels of a chunk by column; 0 for columns that are not controlled.
struct Shares {
    dark: Vec<f32>,
    contrast: Vec<f32>,
}

impl Shares {
    /// The light side's share of a value, see [`Sums::into_records`].
    #[inline(always)]
    fn share(&self, column: usize, value: f32) -> f64 {
        match f64::from(self.contrast[column]) {
            0.0 => 0.5,
            contrast => f64::from(value - self.dark[column]) / contrast,
        }
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
