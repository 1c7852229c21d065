//! Reduces a photograph to small squares, and finds even rectangles among them.

use crate::frame::Colour;
use crate::least_squares::robust_mean;
use crate::view::PhotoView;

/// Tiles along the shorter side of a frame.
const TILES: usize = 160;
/// Tiles along each side of a coarse one.
const COARSE: usize = 4;
/// Samples of a site along each side of a tile, for its mean.
const SAMPLES: usize = 4;
/// Tiles that differ by less are connected: relative, and as a share of the frame's brightest.
pub(crate) const EVEN: (f64, f64) = (0.04, 0.003);
/// Shortest side of a patch in tiles, and the share of its rectangle that a region must fill.
const SHORTEST: usize = 4;
const FILLED: f64 = 0.8;
/// Largest ratio of sides among the patches of a row.
const ALIKE: f64 = 1.3;
/// Largest number of regions that are examined, the largest first.
const MOST: usize = 150;

/// A frame in small squares: light divided by the flat, by colour.
#[derive(Debug, Clone)]
pub(crate) struct Tiles {
    pub side_px: usize,
    pub columns: usize,
    pub rows: usize,
    pub light: Vec<Vec<f64>>,
    pub floor: f64,
}

/// An even rectangle. Lengths in tiles.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct EvenRegion {
    pub middle: [f64; 2],
    pub size: [f64; 2],
    pub light: Vec<f64>,
    tiles: usize,
}

/// Whether sides are equal within the ratio that is allowed in a row.
pub(crate) fn alike(a: [f64; 2], b: [f64; 2]) -> bool {
    (0..2).all(|k| a[k].max(b[k]) <= ALIKE * a[k].min(b[k]))
}

impl Tiles {
    pub fn of(view: PhotoView<'_>) -> Self {
        let frame = view.frame();
        let (width, height) = (frame.width(), frame.height());
        let side_px = (width.min(height) / TILES).max(2).next_multiple_of(2);
        let (columns, rows) = (width / side_px, height / side_px);
        let tiles = |colour: Colour| -> Vec<f64> {
            let sites = frame.sites_of(colour);
            let tile = |k: usize| {
                let (left, top) = (k % columns * side_px, k / columns * side_px);
                let (mut sum, mut count) = (0.0, 0_usize);
                for site in &sites {
                    let skip = side_px.div_ceil(site.step * SAMPLES);
                    for (x, y) in site.pixels(left..left + side_px, top..top + side_px, skip) {
                        sum += view.signal(*site, x, y);
                        count += 1;
                    }
                }
                let middle = [left, top].map(|v| (v + side_px / 2) as f64);
                sum / count.max(1) as f64 / view.flat.at(colour, middle[0], middle[1])
            };
            (0..columns * rows).map(tile).collect()
        };
        let light = frame.each(tiles);
        let brightest = light[light.len() / 2].iter().copied().fold(0.0, f64::max);
        Self { side_px, columns, rows, light, floor: EVEN.1 * brightest }
    }

    /// Light in green, or in the only channel.
    pub fn green(&self) -> &[f64] {
        &self.light[self.light.len() / 2]
    }

    /// The mean of some tiles in each column.
    pub fn mean(&self, tiles: &[usize]) -> Vec<f64> {
        let mean = |light: &Vec<f64>| robust_mean(&tiles.iter().map(|t| light[*t]).collect::<Vec<_>>()).0;
        self.light.iter().map(mean).collect()
    }

    fn alike(&self, a: usize, b: usize) -> bool {
        let (a, b) = (self.green()[a], self.green()[b]);
        (a - b).abs() < EVEN.0 * 0.5 * (a + b).abs() + self.floor
    }

    /// A percentile in numbers above black level, in the brightest column.
    pub fn brightness(&self, hundredths: usize) -> f64 {
        self.light.iter().map(|light| percentile(light, hundredths)).fold(0.0, f64::max)
    }

    /// Whether nearly all that is bright is one even rectangle within the frame.
    pub fn has_one_panel(&self) -> bool {
        let brightest = self.regions().into_iter().max_by(|a, b| green(a).total_cmp(&green(b)));
        brightest.is_some_and(|panel| {
            let bright = self.green().iter().filter(|light| **light > 0.5 * green(&panel)).count();
            panel.tiles * 10 > bright * 9 && panel.tiles * 50 > self.green().len()
        })
    }

    /// Means over 4 × 4 tiles, by column and row; and their number in a row of the frame.
    pub fn coarse(&self) -> (Vec<Vec<f64>>, usize) {
        let (columns, rows) = (self.columns / COARSE, self.rows / COARSE);
        let coarse = |light: &Vec<f64>| {
            let mean = |k: usize| {
                let (left, top) = (k % columns * COARSE, k / columns * COARSE);
                let row = |y: usize| light.iter().skip(y * self.columns + left).take(COARSE).sum::<f64>();
                (top..top + COARSE).map(row).sum::<f64>() / (COARSE * COARSE) as f64
            };
            (0..columns * rows).map(mean).collect()
        };
        (self.light.iter().map(coarse).collect(), columns)
    }

    /// The largest number of even rectangles of one size and different brightness at equal distances. One among them may
    /// be as bright as its surroundings.
    pub fn patches_in_a_row(&self) -> usize {
        let regions = self.regions();
        let mut longest = 0;
        for a in &regions {
            for b in regions.iter().filter(|b| b.middle != a.middle && alike(a.size, b.size)) {
                let step = [0, 1].map(|k| b.middle[k] - a.middle[k]);
                if (0..2).any(|k| step[k].abs() > a.size[k]) {
                    longest = longest.max(self.row_length(&regions, a, step));
                }
            }
        }
        longest
    }

    /// Number of rectangles from this one on, until two follow each other that are absent or as bright as the last.
    fn row_length(&self, regions: &[EvenRegion], first: &EvenRegion, step: [f64; 2]) -> usize {
        let (mut last, mut length, mut gap) = (first, 1, false);
        for i in 1.. {
            let middle = [0, 1].map(|k| first.middle[k] + i as f64 * step[k]);
            let is_there = |r: &&EvenRegion| {
                let near = |k: usize| (r.middle[k] - middle[k]).abs() < 0.25 * first.size[k];
                (0..2).all(near) && alike(r.size, first.size)
            };
            let differs = |r: &&EvenRegion| {
                (green(r) - green(last)).abs() > 2.0 * EVEN.0 * green(last).abs() + self.floor
            };
            match regions.iter().find(is_there).filter(differs) {
                Some(region) => (last, length) = (region, i + 1),
                None if gap => break,
                None => gap = true,
            }
        }
        length
    }

    /// Even rectangles, the largest first.
    pub fn regions(&self) -> Vec<EvenRegion> {
        let mut visited = vec![false; self.columns * self.rows];
        let mut regions = Vec::new();
        for start in 0..visited.len() {
            if !visited[start] {
                regions.extend(self.region(&self.flood(start, &mut visited)));
            }
        }
        regions.sort_by_key(|r| std::cmp::Reverse(r.tiles));
        regions.truncate(MOST);
        regions
    }

    /// All tiles that are connected to this one.
    fn flood(&self, start: usize, visited: &mut [bool]) -> Vec<usize> {
        let mut found = vec![start];
        visited[start] = true;
        let mut next = 0;
        while let Some(tile) = found.get(next).copied() {
            next += 1;
            let (x, y) = (tile % self.columns, tile / self.columns);
            let neighbours = [
                (x > 0).then(|| tile - 1),
                (x + 1 < self.columns).then(|| tile + 1),
                (y > 0).then(|| tile - self.columns),
                (y + 1 < self.rows).then(|| tile + self.columns),
            ];
            for other in neighbours.into_iter().flatten() {
                if !visited[other] && self.alike(tile, other) {
                    visited[other] = true;
                    found.push(other);
                }
            }
        }
        found
    }

    fn region(&self, tiles: &[usize]) -> Option<EvenRegion> {
        if tiles.len() < SHORTEST * SHORTEST {
            return None;
        }
        let range = |of: fn(usize, usize) -> usize| {
            let values = tiles.iter().map(|t| of(*t, self.columns));
            Some((values.clone().min()?, values.max()?))
        };
        let (left, right) = range(|t, columns| t % columns)?;
        let (top, bottom) = range(|t, columns| t / columns)?;
        let (width, height) = (right - left + 1, bottom - top + 1);
        let inside = left > 0 && top > 0 && right + 1 < self.columns && bottom + 1 < self.rows;
        let filled = tiles.len() as f64 >= FILLED * (width * height) as f64;
        if !inside || !filled || width.min(height) < SHORTEST {
            return None;
        }
        let light = self.mean(tiles);
        let middle = [0.5 * (left + right + 1) as f64, 0.5 * (top + bottom + 1) as f64];
        Some(EvenRegion { middle, size: [width as f64, height as f64], light, tiles: tiles.len() })
    }
}

/// Light in green, or in the only channel.
fn green(region: &EvenRegion) -> f64 {
    region.light[region.light.len() / 2]
}

/// The value that this share of values does not exceed; 0 without values.
pub(crate) fn percentile(values: &[f64], hundredths: usize) -> f64 {
    let mut sorted = values.to_vec();
    let at = sorted.len() * hundredths / 100;
    if sorted.is_empty() { 0.0 } else { *sorted.select_nth_unstable_by(at, f64::total_cmp).1 }
}
