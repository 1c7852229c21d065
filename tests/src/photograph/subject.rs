//! Describes the subjects of simulated photographs, and blurs them by the lens.

use std::fmt;
use std::sync::Arc;

use rayon::prelude::*;

/// An edge's exact profile: radiance factor of a channel at a distance in mm, positive on the light side.
#[derive(Clone)]
pub struct Edge(Arc<dyn Fn(usize, f64) -> f64 + Send + Sync>);

impl Edge {
    pub fn new(profile: impl Fn(usize, f64) -> f64 + Send + Sync + 'static) -> Self {
        Self(Arc::new(profile))
    }

    #[must_use]
    pub fn at(&self, channel: usize, x_mm: f64) -> f64 {
        (self.0)(channel, x_mm)
    }
}

impl fmt::Debug for Edge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ends = [-5.0, 5.0].map(|x| [0, 1, 2].map(|c| self.at(c, x)));
        f.debug_tuple("Edge").field(&ends).finish()
    }
}

/// The subject in front of the camera. Lengths are in mm in the board's plane, with the edge in use at x = 0 and the
/// frame's middle near y = 0.
#[derive(Debug, Clone)]
pub enum Subject {
    Nothing,
    /// An even sheet with a slope per 100 mm.
    Sheet {
        slope: [f64; 2],
    },
    /// Patches over grey: areas in pixels.
    Patches {
        areas: Vec<[f64; 4]>,
        rho: Vec<f64>,
    },
    Board(Board),
    Slab(Slab),
}

/// A checkerboard whose lines lie at multiples of the square sideways and at half-way between them up and down.
#[derive(Debug, Clone)]
pub struct Board {
    pub square_mm: f64,
    /// Apparent radiance factors, per channel.
    pub light: [f64; 3],
    pub dark: [f64; 3],
    /// −1 with the dark side to the right.
    pub sign: f64,
    /// The edge's bow: x of the edge is bow y².
    pub bow_per_mm: f64,
    /// Mean distance that light spreads sideways within the board.
    pub spread_mm: f64,
}

impl Board {
    /// The difference to a sharp edge: light that spreads has crossed the ink of both sides.
    fn spread(self) -> Edge {
        Edge::new(move |c, x_mm| {
            let own = if x_mm > 0.0 { self.light[c] } else { self.dark[c] };
            0.5 * ((self.light[c] * self.dark[c]).sqrt() - own) * libm::exp(-x_mm.abs() / self.spread_mm)
        })
    }
}

impl Subject {
    fn board(&self) -> Option<&Board> {
        match self {
            Self::Board(board) => Some(board),
            Self::Slab(slab) => Some(&slab.board),
            _ => None,
        }
    }
}

/// A slab that covers part of a board.
#[derive(Debug, Clone)]
pub struct Slab {
    pub board: Board,
    pub edge: Edge,
    /// Left, right, top and bottom of the slab.
    pub rim_mm: [f64; 4],
    /// A bubble: place, radius, and factor on brightness within.
    pub bubble: Option<([f64; 2], f64, f64)>,
}

/// A subject blurred by the lens.
pub(super) struct Image {
    subject: Subject,
    sigma_mm: [f64; 3],
    /// Factor on the blur up and down, due to shake.
    shaken: f64,
    /// Blurred edges on a fine grid.
    tables: Vec<Vec<f64>>,
    /// Likewise the differences to a sharp edge by light that spreads in the board.
    spreads: Vec<Vec<f64>>,
}

/// Standard deviations beyond which an edge is no longer blurred, to 10⁻¹⁰.
const FAR: f64 = 6.5;

const TABLE_REACH_MM: f64 = 20.0;
const TABLE_STEP_MM: f64 = 2e-4;

impl Image {
    /// An image in some of the three channels.
    pub fn new(subject: &Subject, sigma_mm: [f64; 3], shaken: f64, channels: &[usize]) -> Self {
        let table = |c: usize| match subject {
            Subject::Slab(slab) if channels.contains(&c) => blurred(&slab.edge, c, sigma_mm[c]),
            _ => Vec::new(),
        };
        let tables = (0..3).map(table).collect();
        let spread = |c: usize| match subject.board() {
            Some(board) if channels.contains(&c) && board.spread_mm > 0.0 => {
                blurred(&board.clone().spread(), c, sigma_mm[c])
            }
            _ => Vec::new(),
        };
        let spreads = (0..3).map(spread).collect();
        Self { subject: subject.clone(), sigma_mm, shaken, tables, spreads }
    }

    /// Radiance factor at a place of the board's plane that lies at these pixels.
    pub fn at(&self, c: usize, mm: [f64; 2], px: [f64; 2]) -> f64 {
        match &self.subject {
            Subject::Nothing => 0.0,
            Subject::Sheet { slope } => 0.9 * (1.0 + 0.01 * (slope[0] * mm[0] + slope[1] * mm[1])),
            Subject::Patches { areas, rho } => {
                let inside = |a: &[f64; 4]| {
                    (a[0]..a[0] + a[2]).contains(&px[0]) && (a[1]..a[1] + a[3]).contains(&px[1])
                };
                areas.iter().position(inside).map_or(0.19, |i| rho[i])
            }
            Subject::Board(board) => self.board(board, c, mm),
            Subject::Slab(slab) => self.slab(slab, c, mm),
        }
    }

    /// Whether the only edges are those of patches, so that the middle of a pixel represents it.
    pub fn is_even(&self) -> bool {
        matches!(self.subject, Subject::Sheet { .. } | Subject::Patches { .. })
    }

    pub fn is_dark(&self) -> bool {
        matches!(self.subject, Subject::Nothing)
    }

    fn board(&self, board: &Board, c: usize, mm: [f64; 2]) -> f64 {
        let sigma = self.sigma_mm[c];
        let x = mm[0] - board.bow_per_mm * mm[1] * mm[1];
        let sideways = wave(x / board.square_mm, sigma / board.square_mm);
        let down = wave(mm[1] / board.square_mm + 0.5, self.shaken * sigma / board.square_mm);
        let (middle, half) = (0.5 * (board.light[c] + board.dark[c]), 0.5 * (board.light[c] - board.dark[c]));
        let light = middle + half * board.sign * sideways * down;
        if board.spread_mm == 0.0 {
            return light;
        }
        // Light of the other side of the nearest line, which has crossed the ink of both.
        let line = (x / board.square_mm).round();
        let rises = if (line as i64).rem_euclid(2) == 0 { 1.0 } else { -1.0 };
        let z = (x - line * board.square_mm) * rises * board.sign * down.signum();
        light + down.abs() * lookup(&self.spreads[c], z)
    }

    fn slab(&self, slab: &Slab, c: usize, mm: [f64; 2]) -> f64 {
        let sigma = self.sigma_mm[c];
        let [left, right, top, bottom] = slab.rim_mm;
        let side = |z: f64| match z / sigma {
            u if u > FAR => 1.0,
            u if u < -FAR => 0.0,
            u => 0.5 * erfc(-u / std::f64::consts::SQRT_2),
        };
        let cover = side(mm[0] - left) * side(right - mm[0]) * side(mm[1] - top) * side(bottom - mm[1]);
        if cover == 0.0 {
            return self.board(&slab.board, c, mm);
        }
        let x = slab.board.sign * (mm[0] - slab.board.bow_per_mm * mm[1] * mm[1]);
        let mut covered = lookup(&self.tables[c], x);
        if let Some((at, radius, factor)) = slab.bubble {
            let far = libm::hypot(mm[0] - at[0], mm[1] - at[1]);
            covered *= 1.0 + (factor - 1.0) * side(radius - far);
        }
        if cover > 1.0 - 1e-12 {
            return covered;
        }
        cover * covered + (1.0 - cover) * self.board(&slab.board, c, mm)
    }
}

/// A square wave of period 2, +1 between 0 and 1, behind a Gaussian.
fn wave(x: f64, sigma: f64) -> f64 {
    let nearest = x.round();
    if (x - nearest).abs() > FAR * sigma {
        return if (x.floor() as i64).rem_euclid(2) == 0 { 1.0 } else { -1.0 };
    }
    let rises = if (nearest as i64).rem_euclid(2) == 0 { 1.0 } else { -1.0 };
    rises * (1.0 - erfc((x - nearest) / (sigma * std::f64::consts::SQRT_2)))
}

/// The edge convolved with a Gaussian; its jump at 0 is treated separately, so that it is not sampled.
fn blurred(edge: &Edge, c: usize, sigma: f64) -> Vec<f64> {
    let count = (2.0 * TABLE_REACH_MM / TABLE_STEP_MM) as usize + 1;
    let jump = 0.5 * (edge.at(c, 1e-9) - edge.at(c, -1e-9));
    let middle = 0.5 * (edge.at(c, 1e-9) + edge.at(c, -1e-9));
    let smooth = |x: f64| edge.at(c, x) - middle - if x > 0.0 { jump } else { -jump };
    // Without a jump near by, a sum at steps of σ/4 is as exact as one at finer steps, and a line between every tenth
    // place is exact to 10⁻⁶.
    let [near, far] = [120, 24].map(|nodes| kernel(nodes, sigma));
    let x = |i: usize| i as f64 * TABLE_STEP_MM - TABLE_REACH_MM;
    let value = |i: usize, kernel: &[(f64, f64)]| {
        let step = middle + jump * (1.0 - erfc(x(i) / (sigma * std::f64::consts::SQRT_2)));
        step + kernel.iter().map(|(d, w)| w * smooth(x(i) + d)).sum::<f64>()
    };
    let tenths: Vec<f64> = (0..=count / 10).into_par_iter().map(|i| value(10 * i, &far)).collect();
    let between = |i: usize| match (i / 10, 0.1 * (i % 10) as f64) {
        (tenth, 0.0) => tenths[tenth],
        (tenth, share) => tenths[tenth] * (1.0 - share) + tenths[tenth + 1] * share,
    };
    (0..count).into_par_iter().map(|i| if x(i).abs() > 1.0 { between(i) } else { value(i, &near) }).collect()
}

/// Distances and weights of a Gaussian's sum, `nodes` on each side.
fn kernel(nodes: i32, sigma: f64) -> Vec<(f64, f64)> {
    const REACH: f64 = 6.0;
    let steps = (-nodes..=nodes).map(|k| f64::from(k) * REACH / f64::from(nodes));
    let weights: Vec<(f64, f64)> = steps.map(|u| (u * sigma, libm::exp(-0.5 * u * u))).collect();
    let total: f64 = weights.iter().map(|w| w.1).sum();
    weights.into_iter().map(|(d, w)| (d, w / total)).collect()
}

fn lookup(table: &[f64], x: f64) -> f64 {
    let at = ((x + TABLE_REACH_MM) / TABLE_STEP_MM).clamp(0.0, (table.len() - 2) as f64);
    let share = at.fract();
    table[at as usize] * (1.0 - share) + table[at as usize + 1] * share
}

fn erfc(x: f64) -> f64 {
    libm::erfc(x)
}
