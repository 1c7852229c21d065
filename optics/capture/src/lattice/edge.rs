//! Chooses the edge to measure at, and converts pixels to distances from it in the board's plane.

use super::lines::{BoardLine, EdgeStretch};
use super::pose::Pose;
use super::scan::Run;
use crate::estimate::Estimate;
use crate::least_squares::robust_fit;
use crate::light_field::BoardPlane;
use crate::refusal::{Refusal, Side};

/// Half of the crop's sides, in mm: the paper's 1 × 1 cm.
pub const HALF_CROP_MM: f64 = 5.0;

/// Smallest distance between the crop and a square's border along the edge, in mm.
const ROOM_MM: f64 = 1.0;

/// Largest bend within the crop. A parabola of this height widens the blur by 0.002 px², and its ends lie a tenth of a
/// pixel off its mean.
const BEND_PX: f64 = 0.15;

/// The edge in use within the crop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeLine {
    pub from_px: [f64; 2],
    pub to_px: [f64; 2],
    /// Angle to the frame's columns, or to its rows if those are nearer; positive clockwise.
    pub angle_deg: Estimate,
    pub dark_side: Side,
    /// Height of the edge's bow within the crop.
    pub bend_px: Estimate,
}

/// Coordinates along the edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EdgeFrame {
    pub pose: Pose,
    pub square_mm: f64,
    pub run: Run,
    /// Index of the line, and the crop's middle along it, in squares.
    index: f64,
    middle: f64,
    /// 1 if the light side has the larger coordinate, else −1.
    sign: f64,
    /// Place of the edge relative to its line of the lattice: offset + slope · along, in mm.
    offset_mm: f64,
    slope: f64,
}

impl EdgeFrame {
    /// Signed distance from the edge, positive on the light side, and place along it, both in mm.
    pub fn mm(&self, px: [f64; 2]) -> [f64; 2] {
        let squares = self.pose.squares(px);
        let (across, along) = match self.run {
            Run::Down => (squares[0], squares[1]),
            Run::Across => (squares[1], squares[0]),
        };
        let along = (along - self.middle) * self.square_mm;
        let across = (across - self.index) * self.square_mm - self.offset_mm - self.slope * along;
        [self.sign * across / libm::hypot(self.slope, 1.0), along]
    }

    pub fn px(&self, mm: [f64; 2]) -> [f64; 2] {
        let across = self.sign * mm[0] * libm::hypot(self.slope, 1.0) + self.offset_mm + self.slope * mm[1];
        let (across, along) = (self.index + across / self.square_mm, self.middle + mm[1] / self.square_mm);
        self.pose.px(match self.run {
            Run::Down => [across, along],
            Run::Across => [along, across],
        })
    }

    /// The frame of another edge, at x = a + b y of this one.
    pub fn moved(mut self, [a, b]: [f64; 2], light_is_here: bool) -> Self {
        let across = self.sign * libm::hypot(self.slope, 1.0);
        self.offset_mm += across * a;
        self.slope += across * b;
        if !light_is_here {
            self.sign = -self.sign;
        }
        self
    }

    /// The plane about the crop's middle.
    pub fn plane(&self) -> BoardPlane {
        const STEP_PX: f64 = 10.0;
        let origin_px = self.px([0.0, 0.0]);
        let [by_x, by_y] = [[STEP_PX, 0.0], [0.0, STEP_PX]].map(|step| {
            self.mm([origin_px[0] + step[0], origin_px[1] + step[1]]).map(|mm| 0.1 * mm / STEP_PX)
        });
        BoardPlane { origin_px, per_px: [[by_x[0], by_y[0]], [by_x[1], by_y[1]]] }
    }

    pub fn mm_per_px(&self) -> f64 {
        self.square_mm * self.pose.pitch(self.px([0.0, 0.0]))
    }

    /// Corners of the crop, in order around it.
    pub fn crop_px(&self) -> [[f64; 2]; 4] {
        let h = HALF_CROP_MM;
        [[-h, -h], [h, -h], [h, h], [-h, h]].map(|mm| self.px(mm))
    }
}

/// Chooses the stretch nearest to the frame's middle, among those with the given dark side.
pub(super) fn choose<'a>(
    down: &'a [BoardLine],
    across: &'a [BoardLine],
    required: Option<Side>,
    middle: [f64; 2],
    min_px: f64,
) -> Option<(&'a BoardLine, &'a EdgeStretch)> {
    let runs = match required {
        Some(Side::Left | Side::Right) => [down, &[]],
        Some(Side::Top | Side::Bottom) => [&[], across],
        None => [down, across],
    };
    let all = runs.into_iter().flatten().flat_map(|line| line.stretches.iter().map(move |s| (line, s)));
    all.filter(|(_, s)| s.length() >= min_px)
        .min_by(|a, b| distance(a.1, middle).total_cmp(&distance(b.1, middle)))
}

fn distance(stretch: &EdgeStretch, middle: [f64; 2]) -> f64 {
    let (at, on) = match stretch.run {
        Run::Down => (middle[0], middle[1]),
        Run::Across => (middle[1], middle[0]),
    };
    let nearest = on.clamp(stretch.from(), stretch.to());
    libm::hypot(stretch.at(nearest) - at, nearest - on)
}

pub(super) fn dark_side(stretch: &EdgeStretch) -> Side {
    match (stretch.run, stretch.rises) {
        (Run::Down, true) => Side::Left,
        (Run::Down, false) => Side::Right,
        (Run::Across, true) => Side::Top,
        (Run::Across, false) => Side::Bottom,
    }
}

/// Coordinates along a stretch, with a robust line of its own: printed lines are not quite a lattice.
pub(super) fn place(
    label: &str,
    line: &BoardLine,
    stretch: &EdgeStretch,
    pose: Pose,
    square_mm: f64,
    size: [f64; 2],
) -> Result<(EdgeFrame, EdgeLine), Refusal> {
    let run = stretch.run;
    let along = |px: [f64; 2]| pose.squares(px)[usize::from(run == Run::Down)];
    let ends = [stretch.points.first(), stretch.points.last()].map(|p| p.map_or(0.0, |p| along(p.px(run))));
    let room_mm = (ends[1] - ends[0]) * square_mm;
    let needed_mm = 2.0 * (HALF_CROP_MM + ROOM_MM);
    if room_mm < needed_mm {
        return Err(Refusal::BorderInCrop { label: label.to_owned(), room_mm, needed_mm });
    }
    // As far from corners as the stretch allows, then as near as possible to the frame's middle.
    let free = (0.5 * room_mm).min(2.0 * HALF_CROP_MM) / square_mm;
    let at_middle = along([0.5 * size[0], 0.5 * size[1]]);
    let middle = at_middle.clamp(ends[0] + free, (ends[1] - free).max(ends[0] + free));
    let sign = if stretch.rises { 1.0 } else { -1.0 };
    let index = f64::from(line.index);
    let mut frame = EdgeFrame { pose, square_mm, run, index, middle, sign, offset_mm: 0.0, slope: 0.0 };
    let straight = straighten(&mut frame, stretch).ok_or_else(|| Refusal::NoBoard {
        label: label.to_owned(),
        seen: "only parts of the edge are visible".to_owned(),
    })?;
    check_inside(label, &frame, size)?;
    let mm_per_px = frame.mm_per_px();
    let bend_px = Estimate::new(straight.bend_mm.value / mm_per_px, straight.bend_mm.std_error / mm_per_px);
    if bend_px.value.abs() > BEND_PX + 3.0 * bend_px.std_error {
        let label = label.to_owned();
        return Err(Refusal::EdgeBent { label, bend_px: bend_px.value, allowed_px: BEND_PX });
    }
    let (from_px, to_px) = (frame.px([0.0, -HALF_CROP_MM]), frame.px([0.0, HALF_CROP_MM]));
    let (dx, dy) = (to_px[0] - from_px[0], to_px[1] - from_px[1]);
    let angle = if run == Run::Down { -libm::atan2(dx, dy) } else { libm::atan2(dy, dx) };
    let angle_deg = Estimate::new(angle.to_degrees(), straight.slope_std_error.to_degrees());
    Ok((frame, EdgeLine { from_px, to_px, angle_deg, dark_side: dark_side(stretch), bend_px }))
}

struct Straight {
    slope_std_error: f64,
    bend_mm: Estimate,
}

/// Fits offset and slope within the crop, and the remaining bow b (along² − h²/3), whose height is b h², h being half of
/// the crop's side.
fn straighten(frame: &mut EdgeFrame, stretch: &EdgeStretch) -> Option<Straight> {
    let row = |t: f64| [1.0, t, t * t - HALF_CROP_MM * HALF_CROP_MM / 3.0];
    let places = stretch.points.iter().map(|p| frame.mm(p.px(frame.run)));
    let places = places.filter(|[_, t]| t.abs() <= HALF_CROP_MM);
    let places: Vec<([f64; 3], f64)> = places.map(|[d, t]| (row(t), frame.sign * d)).collect();
    let (solution, sigma) = robust_fit(&places, 10)?;
    (frame.offset_mm, frame.slope) = (solution.x[0], solution.x[1]);
    let height = HALF_CROP_MM * HALF_CROP_MM;
    Some(Straight {
        slope_std_error: sigma * solution.std_error(1),
        bend_mm: Estimate::new(height * solution.x[2], height * sigma * solution.std_error(2)),
    })
}

fn check_inside(label: &str, frame: &EdgeFrame, size: [f64; 2]) -> Result<(), Refusal> {
    let inside = |px: &[f64; 2]| (0.0..=size[0]).contains(&px[0]) && (0.0..=size[1]).contains(&px[1]);
    match frame.crop_px().iter().find(|px| !inside(px)) {
        None => Ok(()),
        Some([x, y]) => Err(Refusal::OutsideFrame { label: label.to_owned(), x_px: *x, y_px: *y }),
    }
}
