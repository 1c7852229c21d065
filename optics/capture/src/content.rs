//! Recognises what a photograph of a session shows, so that a folder of photographs can be sorted by purpose. Shots of the
//! board are compared with each other: the bare one has the most contrast, and slabs differ where they lie.

use std::collections::BTreeSet;

use crate::black::{Black, Darks};
use crate::flat::Flat;
use crate::frame::Photo;
use crate::lattice::free_length_px;
use crate::refusal::Refusal;
use crate::tiles::{Tiles, percentile};
use crate::view::PhotoView;

/// The subject of a photograph.
#[derive(Debug, Clone)]
pub enum ShotContent {
    /// Nothing but the sensor's black level.
    Dark,
    /// Next to no light, as over a light trap.
    Dim,
    /// An even area: a sheet, or a panel.
    Even,
    /// Grey patches in a row, and their number: 1 is a panel.
    Patches(usize),
    /// Squares of a board.
    Board(BoardGlance),
    Other,
}

/// A shot of the board in small squares.
#[derive(Debug, Clone)]
pub struct BoardGlance {
    /// Light by colour and tile, in numbers above black level.
    light: Vec<Vec<f64>>,
    /// Tiles in a row of the frame.
    columns: usize,
}

/// Largest number in a dark shot, and the largest spread of its samples, as shares of the sensor's range.
const DARK: (f64, f64) = (0.25, 0.03);
/// Largest difference of a dark shot from the black level of its file, likewise.
const SAME: f64 = 0.003;
/// Largest brightness above the black level of a dark shot, and of a shot of a light trap.
const NO_LIGHT: f64 = 2e-4;
const DIM: f64 = 0.04;
/// Shortest edges of a board, as a share of the frame's shorter side.
const BOARD: f64 = 0.5;
/// Fewest patches of a row.
const PATCHES: usize = 4;
/// Least contrast of a board under gel, as a share of the bare one's.
const TRANSPARENT: f64 = 0.85;
/// Difference from which on a tile counts as covered in some shots, and from which on two shots show different slabs.
const COVERED: f64 = 0.05;
const DIFFERENT: f64 = 0.01;
/// Tiles by which rims of a slab that is mounted again may be off.
const OFF: usize = 2;

/// The numbers of a photograph's samples, whatever it shows.
#[derive(Debug, Clone, Copy)]
pub struct FrameNumbers {
    pub mean: f64,
    /// The lowest and the highest hundredth.
    low: f64,
    high: f64,
    /// Mean black level of its file.
    black: Option<f64>,
    /// Highest white level of its file.
    white: Option<f64>,
}

impl FrameNumbers {
    pub fn of(photo: &Photo) -> Self {
        let mut samples: Vec<u16> = photo.frame.samples().iter().step_by(7).copied().collect();
        let mean = samples.iter().map(|s| f64::from(*s)).sum::<f64>() / samples.len() as f64;
        samples.sort_unstable();
        let at = |percent: usize| f64::from(samples[samples.len() * percent / 100]);
        let black = photo.levels.black.map(|levels| levels.iter().sum::<f64>() / 4.0);
        let white = photo.levels.white.map(|levels| levels.into_iter().fold(0.0, f64::max));
        Self { mean, low: at(1), high: at(99), black, white }
    }

    /// The number at which the sensor saturates, as far as this photograph shows it.
    pub fn most(&self) -> f64 {
        self.white.unwrap_or(self.high)
    }

    /// Whether it may be a dark shot of a sensor with this range: at the black level of its file, or dim, and as even as
    /// noise leaves it.
    pub fn may_be_dark(&self, range: f64) -> bool {
        let is_low = self.black.map_or(self.high < DARK.0 * range, |black| self.mean < black + SAME * range);
        is_low && self.high - self.low < DARK.1 * range
    }
}

/// The subject of a photograph. Without dark shots, the black level is that of its file. `most` is the number at which the
/// sensor saturates.
pub fn content(photo: &Photo, darks: Darks, most: f64) -> Result<ShotContent, Refusal> {
    let black = darks.finish(photo)?;
    let view = PhotoView { photo, black: &black, flat: &Flat::even() };
    let tiles = Tiles::of(view);
    let range = (most - mean_level(&black)).max(1.0);
    if tiles.brightness(50) < NO_LIGHT * range {
        return Ok(ShotContent::Dark);
    }
    if tiles.brightness(90) < DIM * range {
        return Ok(ShotContent::Dim);
    }
    if tiles.has_one_panel() {
        return Ok(ShotContent::Patches(1));
    }
    let patches = tiles.patches_in_a_row();
    if patches >= PATCHES {
        return Ok(ShotContent::Patches(patches));
    }
    Ok(match free_length_px(view) {
        None => ShotContent::Even,
        Some(edges_px) if edges_px < BOARD * photo.frame.width().min(photo.frame.height()) as f64 => {
            ShotContent::Other
        }
        Some(_) => {
            let (light, columns) = tiles.coarse();
            ShotContent::Board(BoardGlance { light, columns })
        }
    })
}

fn mean_level(black: &Black) -> f64 {
    let levels = black.levels();
    levels.iter().map(|level| level.value).sum::<f64>() / levels.len().max(1) as f64
}

/// The subjects of shots of one board: bare shots are 0, shots of the same slab have the same number. In the second list
/// are the subjects with nearly the contrast of the bare board. All frames must have the same size.
pub fn board_subjects(shots: &[BoardGlance]) -> (Vec<usize>, Vec<usize>) {
    let compared = ComparedBoards::new(shots);
    let mut subjects: Vec<usize> = (0..shots.len()).collect();
    for i in 0..shots.len() {
        for j in 0..i {
            if subjects[i] != subjects[j] && compared.difference(i, j) < DIFFERENT {
                let (from, to) = (subjects[i], subjects[j]);
                subjects.iter_mut().filter(|subject| **subject == from).for_each(|subject| *subject = to);
            }
        }
    }
    // Everything that lies on the board lowers its contrast.
    let contrast: Vec<f64> = (0..shots.len()).map(|shot| compared.contrast(shot)).collect();
    let bare = (0..shots.len()).max_by(|a, b| contrast[*a].total_cmp(&contrast[*b]));
    let mut order: Vec<usize> = bare.map(|bare| subjects[bare]).into_iter().collect();
    for subject in &mut subjects {
        let known = order.iter().position(|known| known == subject);
        *subject = known.unwrap_or_else(|| {
            order.push(*subject);
            order.len() - 1
        });
    }
    let least = bare.map_or(0.0, |bare| TRANSPARENT * contrast[bare]);
    let transparent =
        subjects.iter().zip(&contrast).filter(|(subject, contrast)| **subject > 0 && **contrast > least);
    let transparent: BTreeSet<usize> = transparent.map(|(subject, _)| *subject).collect();
    (subjects, transparent.into_iter().collect())
}

/// Shots of one board where slabs lie on some of them.
struct ComparedBoards {
    /// Light by shot, colour and covered tile, as a share of white, with the same lamps over the free part of the board.
    shares: Vec<Vec<Vec<f64>>>,
}

impl ComparedBoards {
    fn new(shots: &[BoardGlance]) -> Self {
        let colours = shots.first().map_or(0, |first| first.light.len());
        let white: Vec<f64> = (0..colours)
            .map(|colour| shots.iter().map(|shot| percentile(&shot.light[colour], 96)).fold(1.0, f64::max))
            .collect();
        let (covered, free) = covered_tiles(shots, &white);
        let sum =
            |shot: &BoardGlance, colour: usize| free.iter().map(|t| shot.light[colour][*t]).sum::<f64>();
        let share = |shot: &BoardGlance, colour: usize| {
            let (own, first) = (sum(shot, colour), sum(&shots[0], colour));
            let lamps = if own > 0.0 { first / own } else { 1.0 };
            covered.iter().map(|tile| shot.light[colour][*tile] * lamps / white[colour]).collect()
        };
        Self {
            shares: shots
                .iter()
                .map(|shot| (0..colours).map(|colour| share(shot, colour)).collect())
                .collect(),
        }
    }

    /// Difference that seven tenths of the tiles do not exceed: rims of slabs that are mounted again are fewer tiles, one
    /// side of the edge is more.
    fn difference(&self, a: usize, b: usize) -> f64 {
        let tiles = self.shares[a].first().map_or(0, Vec::len);
        let difference = |tile: usize| {
            let colours = self.shares[a].iter().zip(&self.shares[b]);
            colours.map(|(a, b)| (a[tile] - b[tile]).abs()).fold(0.0, f64::max)
        };
        percentile(&(0..tiles).map(difference).collect::<Vec<_>>(), 70)
    }

    /// Standard deviation of light over the tiles.
    fn contrast(&self, shot: usize) -> f64 {
        let variance = |shares: &Vec<f64>| {
            let n = shares.len().max(1) as f64;
            let mean = shares.iter().sum::<f64>() / n;
            shares.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n
        };
        self.shares[shot].iter().map(variance).sum::<f64>().sqrt()
    }
}

/// Tiles that differ between the shots, without those near the rims of slabs if others are left; and tiles that do not.
fn covered_tiles(shots: &[BoardGlance], white: &[f64]) -> (Vec<usize>, Vec<usize>) {
    let Some(first) = shots.first() else { return (Vec::new(), Vec::new()) };
    let differs = |tile: usize| {
        white.iter().enumerate().any(|(colour, white)| {
            let values = shots.iter().map(|shot| shot.light[colour][tile]);
            let (low, high) = values.fold((f64::INFINITY, 0.0), |(low, high), v| (v.min(low), v.max(high)));
            high - low > COVERED * white
        })
    };
    let covered: Vec<bool> = (0..first.light.first().map_or(0, Vec::len)).map(differs).collect();
    let (columns, rows) = (first.columns, covered.len() / first.columns.max(1));
    let near = |at: usize, end: usize| at.saturating_sub(OFF)..(at + OFF + 1).min(end);
    let is_inner = |tile: &usize| {
        let (x, y) = (tile % columns, tile / columns);
        near(y, rows).all(|y| near(x, columns).all(|x| covered[y * columns + x]))
    };
    let (tiles, free): (Vec<usize>, Vec<usize>) = (0..covered.len()).partition(|tile| covered[*tile]);
    let inner: Vec<usize> = tiles.iter().copied().filter(is_inner).collect();
    (if inner.is_empty() { tiles } else { inner }, free)
}
