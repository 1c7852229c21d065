//! Finds places of edges along rows and columns, to a fraction of a pixel.
//!
//! Between a plateau L on one side and R on the other, a symmetrically blurred edge lies at a + h Σ (R − v_i)/(R − L),
//! where the sum runs over samples at pitch h from a on. That is linear in the samples, so noise does not bias it, and
//! no shape of the blur is assumed.

use std::ops::Range;

use rayon::prelude::*;

use crate::frame::Site;
use crate::view::PhotoView;

/// Direction in which a line of the board runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Run {
    /// Up and down: found along rows.
    Down,
    /// Left to right: found along columns.
    Across,
}

/// An edge between black and white, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EdgePoint {
    /// Place along the scanned row or column.
    pub at: f64,
    /// Place of the row or column.
    pub on: f64,
    /// Brighter after the edge than before it.
    pub rises: bool,
    /// Levels on both sides, in numbers above black level.
    pub low: f64,
    pub high: f64,
}

impl EdgePoint {
    pub fn px(&self, run: Run) -> [f64; 2] {
        match run {
            Run::Down => [self.at, self.on],
            Run::Across => [self.on, self.at],
        }
    }
}

/// The levels of black and white, in numbers above black level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Contrast {
    pub black: f64,
    pub white: f64,
}

impl Contrast {
    /// The 4th and 96th percentiles; None if they do not differ enough.
    pub fn of(view: PhotoView<'_>) -> Option<Self> {
        let frame = view.frame();
        let mut values = Vec::new();
        let skip = (frame.width() * frame.height() / 200_000).isqrt().max(1);
        for site in frame.sites_of(view.sharpest()) {
            let pixels = site.pixels(0..frame.width(), 0..frame.height(), skip);
            values.extend(pixels.map(|(x, y)| view.signal(site, x, y)));
        }
        values.sort_by(f64::total_cmp);
        let part = |hundredths: usize| values[values.len() * hundredths / 100];
        let (dark, light) = (part(4), part(96));
        (light > 30.0 && dark < 0.6 * light).then_some(Self { black: dark, white: light })
    }

    pub fn range(&self) -> f64 {
        self.white - self.black
    }

    /// The contrast of the same board under other light, with a share of the contrast added.
    pub fn under(self, brightness: f64, added: f64) -> Self {
        let added = added * self.range();
        Self { black: self.black * brightness + added, white: self.white * brightness + added }
    }

    fn middle(&self) -> f64 {
        f64::midpoint(self.black, self.white)
    }

    /// Whether levels on both sides of an edge are black and white, within a share of the contrast.
    fn fits(&self, low: f64, high: f64, share: f64) -> bool {
        let range = self.range();
        (low - self.black).abs() < share * range && (high - self.white).abs() < share * range
    }
}

/// Settings of the search for edges.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EdgeScan {
    pub contrast: Contrast,
    /// Distance from the edge at which its plateaus begin, in pixels.
    pub reach_px: f64,
    /// Accepted deviation of plateaus from the board's levels, as a share of the contrast.
    pub share: f64,
}

/// Length of plateaus, where the frame allows, in pixels.
const PLATEAU_PX: f64 = 8.0;

/// Number of rows and columns that are scanned: enough for a line to 0.001 px.
const LINES: usize = 1200;

impl EdgeScan {
    /// All edges of a photograph.
    pub fn run(&self, view: PhotoView<'_>, run: Run) -> Vec<EdgePoint> {
        let whole = 0..if run == Run::Down { view.frame().width() } else { view.frame().height() };
        self.within(view, run, |_| vec![whole.clone()])
    }

    /// Edges within some ranges of each row or column.
    pub fn within<F>(&self, view: PhotoView<'_>, run: Run, ranges: F) -> Vec<EdgePoint>
    where
        F: Fn(f64) -> Vec<Range<usize>> + Sync,
    {
        let across = if run == Run::Down { view.frame().height() } else { view.frame().width() };
        let skip = across.div_ceil(LINES).max(1);
        let lines: Vec<usize> = (0..across).step_by(skip).collect();
        let line = |on: &usize| {
            let ranges = ranges(*on as f64 + 0.5).into_iter();
            ranges.flat_map(|range| self.line(view, run, *on, range)).collect::<Vec<_>>()
        };
        lines.par_iter().flat_map_iter(line).collect()
    }

    fn line(&self, view: PhotoView<'_>, run: Run, on: usize, range: Range<usize>) -> Vec<EdgePoint> {
        let is_on = |site: &Site| if run == Run::Down { site.has_row(on) } else { site.has_column(on) };
        let mut sites: Vec<Site> = view.frame().sites_of(view.sharpest()).into_iter().filter(is_on).collect();
        let from = |site: &Site| match run {
            Run::Down => site.column_from(range.start),
            Run::Across => site.row_from(range.start),
        };
        sites.sort_by_key(from);
        let Some(first) = sites.first().map(from) else { return Vec::new() };
        // In a monochrome frame two sites alternate.
        let pitch = sites[0].step / sites.len();
        let value = |i: usize| {
            let site = sites[(i - first) / pitch % sites.len()];
            if run == Run::Down { view.signal(site, i, on) } else { view.signal(site, on, i) }
        };
        let values: Vec<f64> = (first..range.end).step_by(pitch).map(value).collect();
        let line = ScanLine { values: &values, first: first as f64 + 0.5, pitch: pitch as f64 };
        let middle = on as f64 + 0.5;
        let light = |at| view.light(if run == Run::Down { [at, middle] } else { [middle, at] });
        self.crossings(&line, middle, light)
    }

    fn crossings(&self, line: &ScanLine<'_>, on: f64, light: impl Fn(f64) -> f64) -> Vec<EdgePoint> {
        let middle = self.contrast.middle();
        (1..line.values.len())
            .filter(|i| (line.values[i - 1] < middle) != (line.values[*i] < middle))
            .filter_map(|i| self.place(line, i, on, &light))
            .collect()
    }

    /// Place of the edge between samples i − 1 and i.
    fn place(
        &self,
        line: &ScanLine<'_>,
        i: usize,
        on: f64,
        light: &impl Fn(f64) -> f64,
    ) -> Option<EdgePoint> {
        let core = (self.reach_px / line.pitch).ceil() as usize;
        let long = (PLATEAU_PX / line.pitch).ceil() as usize;
        let (from, to) = (i.checked_sub(core)?, i + core);
        let (start, end) = (from.saturating_sub(long), (to + long).min(line.values.len()));
        if from < start + 2 || end < to + 2 {
            return None;
        }
        let values = line.even(start..end, i, light);
        let (core, right) = values.split_at(to - start);
        let (left, core) = core.split_at(from - start);
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (left, right) = (mean(left), mean(right));
        let (low, high) = (left.min(right), left.max(right));
        if !self.contrast.fits(low, high, self.share) {
            return None;
        }
        let sum: f64 = core.iter().map(|v| (right - v) / (right - left)).sum();
        let at = line.first + line.pitch * (from as f64 - 0.5 + sum);
        Some(EdgePoint { at, on, rises: right > left, low, high })
    }
}

struct ScanLine<'a> {
    values: &'a [f64],
    first: f64,
    pitch: f64,
}

impl ScanLine<'_> {
    fn at(&self, i: usize) -> f64 {
        self.first + self.pitch * i as f64
    }

    /// Samples corrected to the light at sample `middle`, since a gradient of the light across plateaus would shift
    /// edges.
    fn even(&self, range: Range<usize>, middle: usize, light: impl Fn(f64) -> f64) -> Vec<f64> {
        let (first, last) = (light(self.at(range.start)), light(self.at(range.end)));
        let rise = 2.0 * (last - first) / ((last + first) * (range.end - range.start) as f64);
        range.map(|k| self.values[k] / (1.0 + rise * (k as f64 - middle as f64))).collect()
    }
}
