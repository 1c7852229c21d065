//! Groups edge points into straight stretches, and stretches into numbered lines of the board.

use super::scan::{EdgePoint, Run};
use crate::estimate::Estimate;
use crate::least_squares::{NormalEquations, spread, tukey};

/// A straight stretch of edge between two corners.
#[derive(Debug, Clone)]
pub(crate) struct EdgeStretch {
    pub run: Run,
    pub rises: bool,
    pub points: Vec<EdgePoint>,
    /// at = offset + slope · on
    pub offset: f64,
    pub slope: f64,
}

impl EdgeStretch {
    pub fn at(&self, on: f64) -> f64 {
        self.offset + self.slope * on
    }

    pub fn from(&self) -> f64 {
        self.points.first().map_or(0.0, |p| p.on)
    }

    pub fn to(&self) -> f64 {
        self.points.last().map_or(0.0, |p| p.on)
    }

    pub fn length(&self) -> f64 {
        (self.to() - self.from()) * libm::hypot(self.slope, 1.0)
    }

    /// Angle to the frame's columns or rows, positive clockwise.
    pub fn angle_deg(&self) -> Estimate {
        let n = self.points.len() as f64;
        let mean = self.points.iter().map(|p| p.on).sum::<f64>() / n;
        let squares: f64 = self.points.iter().map(|p| (p.on - mean).powi(2)).sum();
        let residuals: Vec<f64> = self.points.iter().map(|p| p.at - self.at(p.on)).collect();
        let error = spread(&residuals) / squares.sqrt() / (1.0 + self.slope * self.slope);
        let angle = if self.run == Run::Down { -libm::atan(self.slope) } else { libm::atan(self.slope) };
        Estimate::new(angle.to_degrees(), error.to_degrees())
    }
}

/// Fewest points and pixels of a stretch.
const POINTS: usize = 12;

/// Largest slope relative to rows or columns, so that each edge belongs to one direction: 35°.
const SLOPE: f64 = 0.7;

/// Chains of points that continue from row to row.
pub(crate) fn stretches(points: &[EdgePoint], run: Run, min_px: f64) -> Vec<EdgeStretch> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.on.total_cmp(&b.on).then(a.at.total_cmp(&b.at)));
    let pitch = pitch(&sorted);
    let mut open: Vec<Vec<EdgePoint>> = Vec::new();
    let mut closed = Vec::new();
    for point in sorted {
        let near = |chain: &&mut Vec<EdgePoint>| {
            chain.last().is_some_and(|last| {
                let gap = point.on - last.on;
                last.rises == point.rises && gap > 0.0 && (point.at - last.at).abs() < 1.5 + SLOPE * gap
            })
        };
        match open.iter_mut().find(near) {
            Some(chain) => chain.push(point),
            None => open.push(vec![point]),
        }
        let (keep, done): (Vec<_>, Vec<_>) = open
            .into_iter()
            .partition(|chain| chain.last().is_some_and(|last| point.on - last.on < 12.0 * pitch));
        open = keep;
        closed.extend(done);
    }
    closed.extend(open);
    let mut found: Vec<EdgeStretch> = closed.into_iter().filter_map(|points| fit(points, run)).collect();
    found.retain(|s| s.length() >= min_px);
    found
}

fn pitch(sorted: &[EdgePoint]) -> f64 {
    let steps = sorted.windows(2).map(|p| p[1].on - p[0].on).filter(|d| *d > 0.0);
    steps.fold(f64::INFINITY, f64::min).clamp(1.0, 100.0)
}

fn fit(points: Vec<EdgePoint>, run: Run) -> Option<EdgeStretch> {
    if points.len() < POINTS {
        return None;
    }
    let middle = points.iter().map(|p| p.on).sum::<f64>() / points.len() as f64;
    let mut weights = vec![1.0; points.len()];
    let (mut offset, mut slope) = (0.0, 0.0);
    let mut kept = points;
    for round in 0..8 {
        let mut normal = NormalEquations::new(2);
        for (p, w) in kept.iter().zip(&weights) {
            normal.add(&[1.0, p.on - middle], p.at, *w);
        }
        let line = normal.solve()?;
        (offset, slope) = (line.x[0], line.x[1]);
        let residual = |p: &EdgePoint| p.at - offset - slope * (p.on - middle);
        // Lines that are bent by lens distortion stay whole: their bend is no outlier.
        let sigma = spread(&kept.iter().map(residual).collect::<Vec<_>>()).max(0.02);
        if round == 7 {
            kept.retain(|p| residual(p).abs() < 6.0 * sigma);
        } else {
            weights = kept.iter().map(|p| tukey(residual(p) / sigma)).collect();
        }
    }
    let rises = kept.first()?.rises;
    (kept.len() >= POINTS && slope.abs() < SLOPE).then_some(EdgeStretch {
        run,
        rises,
        points: kept,
        offset: offset - slope * middle,
        slope,
    })
}

/// Stretches on one line of the board.
#[derive(Debug, Clone)]
pub(crate) struct BoardLine {
    pub stretches: Vec<EdgeStretch>,
    /// Index of the line in the lattice.
    pub index: i32,
}

/// Lines of one direction, numbered in squares from the first. An error explains why they form no lattice.
pub(crate) fn number(stretches: Vec<EdgeStretch>, middle_on: f64) -> Result<Vec<BoardLine>, String> {
    let mut groups: Vec<Vec<EdgeStretch>> = Vec::new();
    for stretch in stretches {
        let home = groups.iter_mut().find(|g| g.iter().any(|other| continues(other, &stretch)));
        match home {
            Some(group) => group.push(stretch),
            None => groups.push(vec![stretch]),
        }
    }
    let place = |g: &[EdgeStretch]| {
        let longest = g.iter().max_by(|a, b| a.length().total_cmp(&b.length()));
        longest.map_or(0.0, |s| s.at(middle_on))
    };
    groups.sort_by(|a, b| place(a).total_cmp(&place(b)));
    let places: Vec<f64> = groups.iter().map(|g| place(g)).collect();
    let square = places.windows(2).map(|p| p[1] - p[0]).fold(f64::INFINITY, f64::min);
    let mut lines = Vec::new();
    for (group, at) in groups.into_iter().zip(&places) {
        let squares = if square.is_finite() { (at - places[0]) / square } else { 0.0 };
        if (squares - squares.round()).abs() > 0.2 {
            return Err(format!("the lines at {at:.0} px are {squares:.2} squares from the first one"));
        }
        lines.push(BoardLine { stretches: group, index: squares.round() as i32 });
    }
    Ok(lines)
}

/// Whether two stretches lie on one line, which a lens may bend by a few pixels.
fn continues(a: &EdgeStretch, b: &EdgeStretch) -> bool {
    let between =
        if a.to() < b.from() { f64::midpoint(a.to(), b.from()) } else { f64::midpoint(b.to(), a.from()) };
    (a.at(between) - b.at(between)).abs() < 5.0 + 0.03 * (a.length() + b.length())
}
