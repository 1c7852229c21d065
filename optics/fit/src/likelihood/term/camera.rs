//! Transforms a simulated profile to a camera's view of it: shifts, blurs, and averages it over the measurement's pixels.
//!
//! The simulated profile is given by its averages over the dictionary's pixels, so its integral is known exactly at their
//! edges. Measured pixels take differences of that integral: pixels of any size and position are treated alike, and the
//! measured values are not resampled, so their noise stays independent.

mod edge;
#[cfg(test)]
mod tests;

use std::f64::consts::PI;

use crate::dictionary::wide::wide;
use crate::likelihood::point::Line;
use crate::surrogate::interpolation::{LANES, Place};

use edge::EdgeBlur;

/// Number of pixels by which a profile is continued beyond each end.
const PADDING: usize = 40;
/// Number of pixels at an end from which the profile is continued.
const TAIL: usize = 16;
/// Length of the circular kernel of the blur.
const KERNEL: usize = 64;
/// Taps of one side, the middle one included.
const TAPS: usize = KERNEL / 2 + 1;
/// Sum of the taps that a derivative may lack.
const NEGLIGIBLE: f64 = 1e-4;
/// Number of pixels that are summed at a time: as many as vector registers hold.
const BLOCK: usize = 16;
/// Distance from the edge between black and white, in pixels, within which a place counts as the edge itself: x in files
/// is rounded.
const AT_STEP: f64 = 1e-4;

/// The pixels of a measurement over those of a dictionary.
#[derive(Debug, Clone)]
pub(crate) struct Camera {
    /// Edges of the measured pixels in units of the dictionary's, from the left end of its first.
    edges: Vec<f64>,
    /// Pitch of the dictionary in mm.
    pitch_mm: f64,
    /// Pixels of the dictionary.
    pixels: usize,
}

/// A profile on the measured pixels, with derivatives.
#[derive(Debug)]
pub(crate) struct ExposedProfile {
    pub values: Line,
    /// Derivatives by the quantities of the caller's `slopes`.
    pub slopes: Vec<Line>,
    /// Derivative by the blur's variance in mm².
    pub by_blur: Line,
    /// Derivative by the position of the edge in mm.
    pub by_origin: Line,
}

impl Camera {
    /// For pixel centres at a constant pitch, over a dictionary of this width and number of pixels.
    pub(crate) fn new(x_mm: &[f64], measured_pitch_mm: f64, width_mm: f64, pixels: usize) -> Self {
        let pitch_mm = width_mm / pixels as f64;
        let left = x_mm[0] - 0.5 * measured_pitch_mm;
        let edge = |i: usize| (left + i as f64 * measured_pitch_mm + 0.5 * width_mm) / pitch_mm;
        Self { edges: (0..=x_mm.len()).map(edge).collect(), pitch_mm, pixels }
    }

    /// A profile on the dictionary's pixels, and its derivatives, transformed to the measured pixels.
    pub(crate) fn expose(
        &self,
        values: &[f64],
        slopes: &[Line],
        origin_mm: f64,
        blur_mm2: f64,
    ) -> ExposedProfile {
        let blur = self.blur(blur_mm2);
        let places = self.places(origin_mm);
        let padded = pad(values);
        let blurred = blur.blurred(&padded);
        let by_origin = self.by_origin(&places, &integral(&blurred));
        let mut by_variance = blur.by_variance(&padded);
        for v in &mut by_variance {
            *v /= self.pitch_mm.powi(2);
        }
        let mut all = vec![blurred, by_variance];
        all.extend(slopes.iter().map(|slope| blur.blurred_slope(&pad(slope))));
        let mut seen = averages(&places, &all);
        let slopes = seen.split_off(2);
        let [values, by_blur] = seen.try_into().expect("there are two");
        ExposedProfile { values, slopes, by_blur, by_origin }
    }

    /// The values of profiles alone, without a blur.
    pub(crate) fn sharp(&self, profiles: &[Line], origin_mm: f64) -> Vec<Line> {
        let padded: Vec<Line> = profiles.iter().map(|values| pad(values)).collect();
        averages(&self.places(origin_mm), &padded)
    }

    /// The values alone.
    #[cfg(test)]
    fn values(&self, values: &[f64], origin_mm: f64, blur_mm2: f64) -> Line {
        averages(&self.places(origin_mm), &[self.blur(blur_mm2).blurred(&pad(values))]).remove(0)
    }

    fn blur(&self, blur_mm2: f64) -> Blur {
        let variance = blur_mm2 / self.pitch_mm.powi(2);
        let kernel = BlurKernel::new(variance);
        let edge = self.step().map(|at| (at, EdgeBlur::new(variance, &kernel)));
        Blur { kernel, edge }
    }

    /// The first pixel after the edge between black and white in a padded profile, if the edge lies between pixels.
    fn step(&self) -> Option<usize> {
        self.pixels.is_multiple_of(2).then_some(self.pixels / 2 + PADDING)
    }

    /// The edges of the measured pixels in a padded profile whose step between black and white lies at `origin_mm` of the
    /// measurement.
    fn places(&self, origin_mm: f64) -> Vec<Edge> {
        let shift = PADDING as f64 - origin_mm / self.pitch_mm;
        self.edges.iter().map(|e| self.edge(e + shift)).collect()
    }

    /// `at` counts pixels from the first node of the padded profile.
    fn edge(&self, at: f64) -> Edge {
        let cells = self.pixels + 2 * PADDING;
        let place = match self.step() {
            None => Place::new(at, 0..cells),
            Some(step) if (at - step as f64).abs() < AT_STEP => Place::at_step(step, at),
            Some(step) if at < step as f64 => Place::new(at, 0..step),
            Some(step) => Place::new(at, step..cells),
        };
        Edge { at, place }
    }

    /// Derivatives of the averages by the origin, from the difference of the values at both ends of each pixel.
    fn by_origin(&self, edges: &[Edge], integral: &[f64]) -> Line {
        let at_edges: Line = edges.iter().map(|e| e.place.integrand(integral)).collect();
        let change = |(v, e): (&[f64], &[Edge])| -(v[1] - v[0]) / (e[1].at - e[0].at) / self.pitch_mm;
        at_edges.windows(2).zip(edges.windows(2)).map(change).collect()
    }
}

/// An edge of a measured pixel in the padded profile.
struct Edge {
    at: f64,
    place: Place,
}

/// The profile, continued in a straight line at both ends.
fn pad(values: &[f64]) -> Line {
    let (left, right) = (LevelTail::of(values.iter()), LevelTail::of(values.iter().rev()));
    let before = (1..=PADDING).rev().map(|k| left.beyond(k));
    let after = (1..=PADDING).map(|k| right.beyond(k));
    before.chain(values.iter().copied()).chain(after).collect()
}

/// A straight line through the pixels of an end, by least squares.
struct LevelTail {
    mean: f64,
    /// Per pixel inwards.
    slope: f64,
    /// Distance in pixels from the end to the place of the mean.
    middle: f64,
}

impl LevelTail {
    /// The line of an end, whose values are given from the end inwards.
    fn of<'a>(values: impl ExactSizeIterator<Item = &'a f64> + Clone) -> Self {
        let count = TAIL.min(values.len());
        let middle = 0.5 * (count - 1) as f64;
        let mean = values.clone().take(count).sum::<f64>() / count as f64;
        let (mut along, mut squares) = (0.0, 0.0);
        for (i, v) in values.take(count).enumerate() {
            along += (i as f64 - middle) * v;
            squares += (i as f64 - middle).powi(2);
        }
        Self { mean, slope: along / squares, middle }
    }

    /// The value `k` pixels beyond the last.
    fn beyond(&self, k: usize) -> f64 {
        self.mean - self.slope * (k as f64 + self.middle)
    }
}

/// The integral up to every pixel's edge.
fn integral(values: &[f64]) -> Line {
    let mut sum = 0.0;
    let mut all = Vec::with_capacity(values.len() + 1);
    all.push(0.0);
    for v in values {
        sum += v;
        all.push(sum);
    }
    all
}

/// The averages of profiles between edges. Profiles are side by side in vectors, since the sums of an integral wait for
/// each other.
fn averages(edges: &[Edge], profiles: &[Line]) -> Vec<Line> {
    let mut all = Vec::with_capacity(profiles.len());
    for few in profiles.chunks(LANES) {
        let integrals = integrals(few);
        let mut averages = vec![[0.0; LANES]; edges.len() - 1];
        wide(
            #[inline(always)]
            || {
                let mut before = edges[0].place.integrals(&integrals);
                for (average, ends) in averages.iter_mut().zip(edges.windows(2)) {
                    let up_to = ends[1].place.integrals(&integrals);
                    let width = ends[1].at - ends[0].at;
                    *average = std::array::from_fn(|lane| (up_to[lane] - before[lane]) / width);
                    before = up_to;
                }
            },
        );
        all.extend((0..few.len()).map(|lane| averages.iter().map(|average| average[lane]).collect()));
    }
    all
}

/// The integrals of at most [`LANES`] profiles up to every pixel's edge; zeros fill the other lanes.
fn integrals(profiles: &[Line]) -> Vec<[f64; LANES]> {
    let mut sums = [0.0; LANES];
    let mut all = Vec::with_capacity(profiles[0].len() + 1);
    all.push(sums);
    for i in 0..profiles[0].len() {
        sums.iter_mut().zip(profiles).for_each(|(sum, profile)| *sum += profile[i]);
        all.push(sums);
    }
    all
}

/// A Gaussian in the frequencies that pixels can carry, as a circular kernel: exact for profiles that change over several
/// pixels, for every variance down to 0.
#[derive(Debug)]
struct BlurKernel {
    taps: [f64; TAPS],
    by_variance: [f64; TAPS],
}

impl BlurKernel {
    /// `variance` in squared pixels.
    fn new(variance: f64) -> Self {
        let mut kernel = Self { taps: [0.0; TAPS], by_variance: [0.0; TAPS] };
        let share = 1.0 / KERNEL as f64;
        for j in 0..TAPS {
            let omega = 2.0 * PI * j as f64 * share;
            let both = if j == 0 || j == KERNEL / 2 { share } else { 2.0 * share };
            let damping = libm::exp(-0.5 * variance * omega * omega) * both;
            // cos(kω) by its recurrence.
            let (mut before, mut now) = (libm::cos(omega), 1.0);
            let twice = 2.0 * before;
            for k in 0..TAPS {
                kernel.taps[k] += damping * now;
                kernel.by_variance[k] -= 0.5 * omega * omega * damping * now;
                (before, now) = (now, twice * now - before);
            }
        }
        // On the circle both sides share the last tap.
        kernel.taps[TAPS - 1] *= 0.5;
        kernel.by_variance[TAPS - 1] *= 0.5;
        kernel
    }

    /// The first taps, without those that are negligible together.
    fn main_taps(&self) -> &[f64] {
        let mut left_out = 0.0;
        let is_negligible = |tap: &&f64| {
            left_out += 2.0 * tap.abs();
            left_out < NEGLIGIBLE
        };
        let negligible = self.taps.iter().rev().take_while(is_negligible).count();
        &self.taps[..TAPS - negligible]
    }
}

/// The camera's blur over pixels.
struct Blur {
    kernel: BlurKernel,
    /// The first pixel after the edge between black and white, and what the kernel lacks there.
    edge: Option<(usize, EdgeBlur)>,
}

impl Blur {
    fn blurred(&self, padded: &[f64]) -> Line {
        self.blurred_by(&self.kernel.taps, padded)
    }

    /// The blur of a derivative, which need not be as exact as a profile.
    fn blurred_slope(&self, padded: &[f64]) -> Line {
        self.blurred_by(self.kernel.main_taps(), padded)
    }

    fn blurred_by(&self, taps: &[f64], padded: &[f64]) -> Line {
        let mut blurred = convolve(taps, padded);
        if let Some((at, edge)) = &self.edge {
            edge.complete(padded, *at, &mut blurred);
        }
        blurred
    }

    fn by_variance(&self, padded: &[f64]) -> Line {
        let mut by_variance = convolve(&self.kernel.by_variance, padded);
        if let Some((at, edge)) = &self.edge {
            edge.complete_by_variance(padded, *at, &mut by_variance);
        }
        by_variance
    }
}

/// Symmetric convolution. Pixels within the kernel's reach of the ends are left unchanged: they are padding.
fn convolve(taps: &[f64], padded: &[f64]) -> Line {
    let reach = TAPS - 1;
    let mut out = padded.to_vec();
    let (blocks, rest) = out[reach..padded.len() - reach].as_chunks_mut::<BLOCK>();
    let whole = blocks.len() * BLOCK;
    wide(
        #[inline(always)]
        || {
            for (i, block) in blocks.iter_mut().enumerate() {
                *block = convolve_block(taps, padded, reach + i * BLOCK);
            }
            for (i, pixel) in rest.iter_mut().enumerate() {
                [*pixel] = convolve_block(taps, padded, reach + whole + i);
            }
        },
    );
    out
}

/// The pixels from `at` on.
#[expect(clippy::inline_always, reason = "`wide` compiles what is inlined into it")]
#[inline(always)]
fn convolve_block<const N: usize>(taps: &[f64], padded: &[f64], at: usize) -> [f64; N] {
    let pixels = |from: usize| -> &[f64; N] { padded[from..].first_chunk().expect("it is padded") };
    let mut sums = pixels(at).map(|v| taps[0] * v);
    for (k, tap) in taps.iter().enumerate().skip(1) {
        let (left, right) = (pixels(at - k), pixels(at + k));
        for i in 0..N {
            sums[i] += tap * (left[i] + right[i]);
        }
    }
    sums
}
