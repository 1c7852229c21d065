//! Fits the map from pixels to the board's plane.
//!
//! With u the pixel from the frame's middle in half diagonals, r = |u| and u′ = u (1 + k₁ r²),
//! X = (p₀ + p₁ u′ₓ + p₂ u′ᵧ)/(1 + p₆ u′ₓ + p₇ u′ᵧ), Y likewise with p₃, p₄, p₅: a homography behind one radial term
//! (Brown 1966). X and Y count squares.

use optics_model::descent::{Descended, Descent, DescentEnd, DescentStep};

use super::lines::BoardLine;
use super::scan::Run;
use crate::least_squares::{FittedParameters, NormalEquations, spread, tukey};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pose {
    centre: [f64; 2],
    half_diagonal: f64,
    p: [f64; PARAMETERS],
}

const PARAMETERS: usize = 9;

/// Decrease of χ² that justifies a pose with more parameters.
const PAYS: f64 = 9.0;

/// Largest number of points that are fitted.
const TIES: usize = 4000;

/// A point on a numbered line.
#[derive(Debug, Clone, Copy)]
struct Tie {
    px: [f64; 2],
    run: Run,
    index: f64,
}

/// The family of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Freedom {
    Similar,
    Projective,
    Radial,
}

/// A fitted pose.
#[derive(Debug, Clone)]
pub(crate) struct FittedPose {
    pub pose: Pose,
    /// Relative standard error of lengths in the frame's middle.
    pub scale_std_error: f64,
    pub end: DescentEnd,
}

impl Pose {
    /// Squares at a pixel.
    pub fn squares(&self, px: [f64; 2]) -> [f64; 2] {
        let [u, v] = self.undistorted(px);
        let p = &self.p;
        let w = 1.0 + p[6] * u + p[7] * v;
        [(p[0] + p[1] * u + p[2] * v) / w, (p[3] + p[4] * u + p[5] * v) / w]
    }

    /// The pixel at a place of the board, by Newton's method.
    pub fn px(&self, squares: [f64; 2]) -> [f64; 2] {
        let mut px = self.centre;
        for _ in 0..30 {
            let found = self.squares(px);
            let (dx, dy) = (squares[0] - found[0], squares[1] - found[1]);
            let [[a, b], [c, d]] = self.derivative(px);
            let determinant = a * d - b * c;
            let step = [(d * dx - b * dy) / determinant, (a * dy - c * dx) / determinant];
            px = [px[0] + step[0], px[1] + step[1]];
            if step[0].abs() + step[1].abs() < 1e-9 {
                break;
            }
        }
        px
    }

    /// ∂(X, Y)/∂(x, y), squares per pixel.
    pub fn derivative(&self, px: [f64; 2]) -> [[f64; 2]; 2] {
        const STEP: f64 = 0.5;
        let difference = |to: [f64; 2], from: [f64; 2]| {
            let (a, b) = (self.squares(to), self.squares(from));
            [(a[0] - b[0]) / (2.0 * STEP), (a[1] - b[1]) / (2.0 * STEP)]
        };
        let along_x = difference([px[0] + STEP, px[1]], [px[0] - STEP, px[1]]);
        let along_y = difference([px[0], px[1] + STEP], [px[0], px[1] - STEP]);
        [[along_x[0], along_y[0]], [along_x[1], along_y[1]]]
    }

    /// Squares per pixel at a pixel: the root of the ratio of areas.
    pub fn pitch(&self, px: [f64; 2]) -> f64 {
        let [[a, b], [c, d]] = self.derivative(px);
        (a * d - b * c).abs().sqrt()
    }

    fn undistorted(&self, px: [f64; 2]) -> [f64; 2] {
        let u =
            [(px[0] - self.centre[0]) / self.half_diagonal, (px[1] - self.centre[1]) / self.half_diagonal];
        let grown = 1.0 + self.p[8] * (u[0] * u[0] + u[1] * u[1]);
        [u[0] * grown, u[1] * grown]
    }
}

/// Fits lines that run down and across. An error explains why they determine no scale.
pub(crate) fn fit(down: &[BoardLine], across: &[BoardLine], size: [f64; 2]) -> Result<FittedPose, String> {
    let mut ties = Vec::new();
    for (lines, run) in [(down, Run::Down), (across, Run::Across)] {
        for line in lines {
            for point in line.stretches.iter().flat_map(|s| &s.points) {
                ties.push(Tie { px: point.px(run), run, index: f64::from(line.index) });
            }
        }
    }
    // More points add little information: neighbouring points of a line are nearly equal.
    let skip = ties.len().div_ceil(TIES).max(1);
    let ties: Vec<Tie> = ties.into_iter().step_by(skip).collect();
    let (d, a) = (down.len(), across.len());
    if d.max(a) < 2 {
        return Err(format!("{d} lines run up and down, {a} across"));
    }
    let start = similar_start(down, across, size);
    let unable = || "the board's lines contradict each other".to_owned();
    let mut best = solve(start, &ties, Freedom::Similar).ok_or_else(unable)?;
    let both = d >= 2 && a >= 2;
    // The change that a rejected pose would make remains as an uncertainty.
    let mut open = 0.0_f64;
    for freedom in [Freedom::Projective, Freedom::Radial] {
        let Some(freer) = both.then(|| solve(best.pose, &ties, freedom)).flatten() else { continue };
        // Each pose with more parameters must lower χ² by three standard deviations of one parameter.
        if freer.chi_squared(&ties, freer.sigma) + PAYS < best.chi_squared(&ties, freer.sigma) {
            best = freer;
            open = 0.0;
        } else {
            open = libm::hypot(
                open,
                libm::log(freer.pose.pitch(freer.pose.centre) / best.pose.pitch(best.pose.centre)),
            );
        }
    }
    let scale_std_error = libm::hypot(best.scale_error(), open);
    Ok(FittedPose { pose: best.pose, scale_std_error, end: best.end })
}

/// Start of the fit, from the first two lines of a direction that has two.
fn similar_start(down: &[BoardLine], across: &[BoardLine], size: [f64; 2]) -> Pose {
    let centre = [0.5 * size[0], 0.5 * size[1]];
    let half_diagonal = 0.5 * libm::hypot(size[0], size[1]);
    let lines = if down.len() >= 2 { down } else { across };
    let middle = if down.len() >= 2 { centre[1] } else { centre[0] };
    let place = |line: &BoardLine| line.stretches[0].at(middle);
    let (first, last) = (&lines[0], &lines[lines.len() - 1]);
    let slope = first.stretches[0].slope;
    let px = (place(last) - place(first)) / f64::from(last.index - first.index) / libm::hypot(slope, 1.0);
    let turn = if down.len() >= 2 { -libm::atan(slope) } else { libm::atan(slope) };
    let s = half_diagonal / px;
    let (sin, cos) = libm::sincos(turn);
    let mut p = [0.0, s * cos, s * sin, 0.0, -s * sin, s * cos, 0.0, 0.0, 0.0];
    let mut pose = Pose { centre, half_diagonal, p };
    for (lines, row, k) in [(down, 0, Run::Down), (across, 3, Run::Across)] {
        if let Some(line) = lines.first() {
            let point = line.stretches[0].points[0].px(k);
            p[row] = f64::from(line.index) - pose.squares(point)[row / 3];
        }
    }
    pose.p = p;
    pose
}

struct PoseFit {
    pose: Pose,
    freedom: Freedom,
    solution: FittedParameters,
    sigma: f64,
    end: DescentEnd,
}

/// Steps in which all points count, since they still find the place; then they have Tukey's weights.
const ROUGH: usize = 4;
/// The tolerance is the square of a step in squares of the board.
const DESCENT: Descent = Descent { most_steps: 14, tolerance: 1e-16 };
const LEAST_STEPS: usize = 7;
/// Share of its standard error within which the last of all steps counts as none.
const SMALL: f64 = 0.05;

fn solve(start: Pose, ties: &[Tie], freedom: Freedom) -> Option<PoseFit> {
    // The pose after a number of steps, with the solution and the spread of the residuals before the last.
    let step = |(from, taken, ..): &(Pose, usize, f64, Option<FittedParameters>)| {
        let residuals: Vec<f64> = ties.iter().map(|t| residual(from, t)).collect();
        let sigma = spread(&residuals).max(1e-5);
        let mut normal = NormalEquations::new(freedom.count());
        for (tie, r) in ties.iter().zip(&residuals) {
            let weight = if *taken < ROUGH { 1.0 } else { tukey(r / sigma) };
            normal.add(&gradient(from, tie, freedom), -r, weight / (sigma * sigma));
        }
        let (solution, mut pose) = (normal.solve()?, *from);
        freedom.apply(&mut pose, solution.x.as_slice());
        let predicted = solution.x.amax().powi(2);
        Some(DescentStep { to: (pose, taken + 1, sigma, Some(solution)), predicted })
    };
    let Descended { at, end } = DESCENT.whole(LEAST_STEPS, (start, 0, f64::INFINITY, None), step);
    let (pose, _, sigma, solution) = at;
    let solution = solution.filter(|_| end != DescentEnd::NoDescent)?;
    // Tukey's weights let steps shrink slowly: one that is small against its error is the last as well.
    let is_small = |i: usize| solution.x[i].abs() < SMALL * solution.std_error(i);
    let end = if (0..freedom.count()).all(is_small) { DescentEnd::Converged } else { end };
    Some(PoseFit { pose, freedom, solution, sigma, end })
}

/// Pixels between a point and its line.
fn residual(pose: &Pose, tie: &Tie) -> f64 {
    let squares = pose.squares(tie.px);
    let off = if tie.run == Run::Down { squares[0] } else { squares[1] } - tie.index;
    off / pose.pitch(tie.px)
}

fn gradient(pose: &Pose, tie: &Tie, freedom: Freedom) -> Vec<f64> {
    let pitch = pose.pitch(tie.px);
    let off = |p: &Pose| if tie.run == Run::Down { p.squares(tie.px)[0] } else { p.squares(tie.px)[1] };
    (0..freedom.count())
        .map(|k| {
            let mut step = vec![0.0; freedom.count()];
            let mut ends = [0.0; 2];
            for (end, size) in ends.iter_mut().zip([1e-5, -1e-5]) {
                step[k] = size;
                let mut moved = *pose;
                freedom.apply(&mut moved, &step);
                *end = off(&moved);
            }
            (ends[0] - ends[1]) / (2e-5 * pitch)
        })
        .collect()
}

impl Freedom {
    fn count(self) -> usize {
        match self {
            Self::Similar => 4,
            Self::Projective => 8,
            Self::Radial => 9,
        }
    }

    fn apply(self, pose: &mut Pose, step: &[f64]) {
        let p = &mut pose.p;
        if self == Self::Similar {
            // X = x₀ + a u + b v, Y = y₀ − b u + a v.
            for (k, d) in
                [(0, step[0]), (3, step[1]), (1, step[2]), (5, step[2]), (2, step[3]), (4, -step[3])]
            {
                p[k] += d;
            }
        } else {
            for (p, d) in p.iter_mut().zip(step) {
                *p += d;
            }
        }
    }
}

impl PoseFit {
    fn chi_squared(&self, ties: &[Tie], sigma: f64) -> f64 {
        // Outliers count equally in all poses.
        ties.iter().map(|t| (residual(&self.pose, t) / sigma).powi(2).min(25.0)).sum()
    }

    /// Error of the square root of the area in the frame's middle: there ln pitch = ½ ln(p₁p₅ − p₂p₄) + … ,
    /// differentiated by steps.
    fn scale_error(&self) -> f64 {
        let count = self.freedom.count();
        let mut gradient = vec![0.0; count];
        for (k, g) in gradient.iter_mut().enumerate() {
            let mut step = vec![0.0; count];
            let mut ln_pitch = |size: f64| {
                step[k] = size;
                let mut moved = self.pose;
                self.freedom.apply(&mut moved, &step);
                libm::log(moved.pitch(self.pose.centre))
            };
            *g = (ln_pitch(1e-5) - ln_pitch(-1e-5)) / 2e-5;
        }
        let c = &self.solution.covariance;
        let mut variance = 0.0;
        for (i, a) in gradient.iter().enumerate() {
            for (j, b) in gradient.iter().enumerate() {
                variance += a * b * c[(i, j)];
            }
        }
        variance.max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::lines::EdgeStretch;
    use crate::lattice::scan::EdgePoint;

    fn pose(k1: f64) -> Pose {
        let p = [0.3, 1.2, 0.03, -0.1, -0.03, 1.2, 0.01, -0.02, k1];
        Pose { centre: [600.0, 400.0], half_diagonal: 721.0, p }
    }

    /// The mapping from pixels to squares is invertible.
    #[test]
    fn pixel_mapping_is_invertible() {
        let pose = pose(-0.01);
        for px in [[20.0, 30.0], [600.0, 400.0], [1190.0, 700.0]] {
            let back = pose.px(pose.squares(px));
            assert!(libm::hypot(back[0] - px[0], back[1] - px[1]) < 1e-7, "{px:?} {back:?}");
        }
    }

    /// Points of two lines each way, exact.
    fn lines(pose: &Pose, run: Run) -> Vec<BoardLine> {
        let line = |index: i32| {
            let place = |k: i32| {
                let on = -0.35 + 0.05 * f64::from(k);
                pose.px(if run == Run::Down { [f64::from(index), on] } else { [on, f64::from(index)] })
            };
            let point = |px: [f64; 2]| {
                let [at, on] = if run == Run::Down { px } else { [px[1], px[0]] };
                EdgePoint { at, on, rises: true, low: 0.0, high: 1.0 }
            };
            let points: Vec<EdgePoint> = (0..25).map(|k| point(place(k))).collect();
            let slope = (points[24].at - points[0].at) / (points[24].on - points[0].on);
            let offset = points[0].at - slope * points[0].on;
            BoardLine { stretches: vec![EdgeStretch { run, rises: true, points, offset, slope }], index }
        };
        vec![line(0), line(1)]
    }

    /// The pose is found from two lines in each direction.
    #[test]
    fn two_lines_each_way_give_the_pose() {
        for k1 in [0.0, 0.02] {
            let truth = pose(k1);
            let found = fit(&lines(&truth, Run::Down), &lines(&truth, Run::Across), [1200.0, 800.0]).unwrap();
            let scale = found.pose.pitch([600.0, 400.0]) / truth.pitch([600.0, 400.0]);
            assert!((scale - 1.0).abs() < 1e-4, "k₁ {k1}: {scale}");
        }
    }

    /// One line in each direction does not determine the scale.
    #[test]
    fn one_line_each_way_gives_no_scale() {
        let truth = pose(0.0);
        let one = |run| vec![lines(&truth, run).swap_remove(0)];
        assert!(fit(&one(Run::Down), &one(Run::Across), [1200.0, 800.0]).is_err());
    }
}
