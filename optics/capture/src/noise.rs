//! Estimates the sensor's noise from pairs of shots of one subject (EMVA 1288).
//!
//! ½ Var(S₁ − S₂) = σ_r² + K · (S − D): σ_r is the noise without light and K the numbers per electron.

use crate::estimate::Estimate;
use crate::frame::{Colour, Frame, Site};
use crate::least_squares::{NormalEquations, median};
use crate::saturation::Saturation;

/// Noise of the samples of one site.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SiteNoise {
    pub colour: Colour,
    /// σ_r: standard deviation without light, in numbers.
    pub read: Estimate,
    /// K: numbers per electron.
    pub gain: Estimate,
}

impl SiteNoise {
    /// Variance of one sample whose signal above black is `signal`.
    pub fn variance(&self, signal: f64) -> f64 {
        self.read.value.powi(2) + self.gain.value * signal.max(0.0)
    }
}

/// Side of the blocks whose differences are evaluated, in samples of a site.
pub(crate) const SIDE: usize = 16;

/// Largest number of blocks of a pair and site: enough for 1 % of K.
const BLOCKS: usize = 3000;

/// Number of groups of blocks of similar signal.
const GROUPS: usize = 24;

#[derive(Debug, Clone, Copy)]
pub(crate) struct NoiseBlock {
    pub signal: f64,
    pub variance: f64,
}

/// Differences of pairs, and of neighbours in single shots in case there are no pairs.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pairs {
    blocks: Vec<Vec<NoiseBlock>>,
    singles: Vec<Vec<NoiseBlock>>,
}

impl Pairs {
    /// Adds two shots of one subject; `black` is the level of each site, and samples at `saturation` are left out.
    pub fn add(&mut self, a: &Frame, b: &Frame, black: &[Estimate], saturation: Saturation) {
        for site in a.sites() {
            let found = corners(a, site).filter_map(|(i, j)| {
                let (first, second) = (block(a, site, i, j), block(b, site, i, j));
                let level = black[site.index].value;
                let clipped = first.iter().chain(&second).any(|v| saturation.holds(site, *v));
                if clipped { None } else { pair(&first, &second, level) }
            });
            self.blocks.resize(a.sites().len(), Vec::new());
            self.blocks[site.index].extend(found);
        }
    }

    /// Adds one shot: second differences along rows.
    pub fn add_single(&mut self, a: &Frame, black: &[Estimate], saturation: Saturation) {
        for site in a.sites() {
            let found = corners(a, site).filter_map(|(i, j)| {
                let values = block(a, site, i, j);
                let clipped = values.iter().any(|v| saturation.holds(site, *v));
                (!clipped).then(|| single(&values, black[site.index].value))
            });
            self.singles.resize(a.sites().len(), Vec::new());
            self.singles[site.index].extend(found);
        }
    }

    pub fn extend(&mut self, other: &Self) {
        for (own, theirs) in [(&mut self.blocks, &other.blocks), (&mut self.singles, &other.singles)] {
            own.resize(own.len().max(theirs.len()), Vec::new());
            for (a, b) in own.iter_mut().zip(theirs) {
                a.extend(b);
            }
        }
    }

    /// Variance of one sample, from pairs without light.
    pub fn dark_variance(&self, site: usize) -> f64 {
        let blocks = self.blocks.get(site).map_or(&[][..], Vec::as_slice);
        if blocks.is_empty() { 0.0 } else { group(blocks).0.variance }
    }

    pub fn has_pairs(&self) -> bool {
        self.blocks.iter().any(|b| !b.is_empty())
    }

    /// None if the shots do not determine the noise: no shots, or a single brightness.
    pub fn fit(&self, sites: &[Site]) -> Option<Vec<SiteNoise>> {
        sites
            .iter()
            .map(|site| {
                let of_pairs = self.blocks.get(site.index).filter(|b| b.len() >= GROUPS);
                let of_site = of_pairs.or_else(|| self.singles.get(site.index))?;
                line(of_site, site.colour)
            })
            .collect()
    }
}

/// Corners of evenly spread blocks.
pub(crate) fn corners(frame: &Frame, site: Site) -> impl Iterator<Item = (usize, usize)> {
    let (columns, rows) = frame.extent(site);
    let (across, down) = (columns / SIDE, rows / SIDE);
    let skip = (across * down).div_ceil(BLOCKS).max(1);
    (0..across * down).step_by(skip).map(move |k| (k % across * SIDE, k / across * SIDE))
}

pub(crate) fn block(frame: &Frame, site: Site, i: usize, j: usize) -> Vec<f64> {
    let mut values = Vec::with_capacity(SIDE * SIDE);
    for row in j..j + SIDE {
        for column in i..i + SIDE {
            let (x, y) = (site.column + column * site.step, site.row + row * site.step);
            values.push(f64::from(frame.at(site, x, y)));
        }
    }
    values
}

fn pair(a: &[f64], b: &[f64], black: f64) -> Option<NoiseBlock> {
    let n = a.len() as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n - black;
    let (of_a, of_b) = (mean(a), mean(b));
    // Flicker scales a block, which matters only where there is light.
    let ratio = if of_a > 50.0 && of_b > 50.0 { of_a / of_b } else { 1.0 };
    let difference = |(x, y): (&f64, &f64)| (x - black - of_a) - ratio * (y - black - of_b);
    let sum = a.iter().zip(b).map(|p| difference(p).powi(2)).sum::<f64>();
    let variance = sum / ((n - 1.0) * (1.0 + ratio * ratio));
    let structure = a.iter().map(|x| (x - black - of_a).powi(2)).sum::<f64>() / (n - 1.0);
    // Edges and dust that differ between the shots would count as noise.
    (structure < 3.0 * variance + 1.0).then_some(NoiseBlock { signal: f64::midpoint(of_a, of_b), variance })
}

pub(crate) fn single(values: &[f64], black: f64) -> NoiseBlock {
    let mut sum = 0.0;
    let mut count = 0.0;
    for row in values.chunks_exact(SIDE) {
        for three in row.windows(3) {
            sum += (three[0] - 2.0 * three[1] + three[2]).powi(2) / 6.0;
            count += 1.0;
        }
    }
    NoiseBlock { signal: values.iter().sum::<f64>() / values.len() as f64 - black, variance: sum / count }
}

/// Weighted line through the medians of groups of similar signal.
fn line(blocks: &[NoiseBlock], colour: Colour) -> Option<SiteNoise> {
    let mut sorted = blocks.to_vec();
    sorted.sort_by(|a, b| a.signal.total_cmp(&b.signal));
    let groups: Vec<(NoiseBlock, f64)> =
        sorted.chunks(sorted.len().div_ceil(GROUPS).max(1)).map(group).collect();
    let [mut read, mut gain] = [groups.first()?.0.variance.max(0.1), 0.0];
    let mut solution = None;
    for _ in 0..4 {
        let mut normal = NormalEquations::new(2);
        for (at, degrees) in &groups {
            let expected = (read + gain * at.signal).max(0.1);
            normal.add(&[1.0, at.signal], at.variance, degrees / (2.0 * expected * expected));
        }
        let fitted = normal.solve()?;
        // Quantisation alone has a variance of 1/12.
        (read, gain) = (fitted.x[0].max(1.0 / 12.0), fitted.x[1].max(0.0));
        solution = Some(fitted);
    }
    let fitted = solution?;
    let sigma = read.sqrt();
    Some(SiteNoise {
        colour,
        read: Estimate::new(sigma, fitted.std_error(0) / (2.0 * sigma)),
        gain: Estimate::new(gain, fitted.std_error(1)),
    })
}

/// Median of a group, and its effective degrees of freedom.
fn group(blocks: &[NoiseBlock]) -> (NoiseBlock, f64) {
    let freedom = (SIDE * SIDE - 1) as f64;
    // Ratio of median to mean of χ² by Wilson and Hilferty; a median has π/2 times the variance.
    let correction = (1.0 - 2.0 / (9.0 * freedom)).powi(3);
    let block_median = |f: fn(&NoiseBlock) -> f64| median(&mut blocks.iter().map(f).collect::<Vec<_>>());
    let middle = NoiseBlock {
        signal: block_median(|b| b.signal),
        variance: block_median(|b| b.variance) / correction,
    };
    (middle, freedom * blocks.len() as f64 * std::f64::consts::FRAC_2_PI)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{RGGB, normal};

    /// Eight grey stripes with σ_r = 4 and K = 0.7 over a black level of 100.
    fn frame(seed: u64) -> Frame {
        let mut state = seed;
        let samples = (0..512 * 256)
            .map(|i| {
                let signal = 500.0 * f64::from(i % 512 / 64);
                let sigma = (16.0 + 0.7 * signal).sqrt();
                (100.0 + signal + sigma * normal(&mut state)).round().max(0.0) as u16
            })
            .collect();
        Frame::new(512, 256, RGGB, samples).unwrap()
    }

    /// Pairs of frames give the noise without light and the numbers per electron; where no frame was taken twice, a single
    /// one does.
    #[test]
    fn frame_pairs_give_gain_and_read_noise() {
        let (a, b, black) = (frame(1), frame(2), [Estimate::new(100.0, 0.0); 4]);
        let (mut pairs, mut single) = (Pairs::default(), Pairs::default());
        pairs.add(&a, &b, &black, Saturation::all(60_000.0));
        for noise in pairs.fit(&a.sites()).unwrap() {
            // Rounding adds a twelfth to the variance.
            let read = (16.0_f64 + 1.0 / 12.0).sqrt();
            assert!((noise.gain.value / 0.7 - 1.0).abs() < 0.03, "{noise:?}");
            assert!((noise.read.value / read - 1.0).abs() < 0.03, "{noise:?}");
            assert!((noise.gain.value - 0.7).abs() < 4.0 * noise.gain.std_error, "{noise:?}");
        }
        single.add_single(&a, &black, Saturation::all(60_000.0));
        assert!(!single.has_pairs());
        let found = single.fit(&a.sites()).unwrap();
        assert!(found.iter().all(|n| (n.gain.value / 0.7 - 1.0).abs() < 0.05), "{found:?}");
    }
}
