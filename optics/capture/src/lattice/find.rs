//! Finds the board in a photograph, and the free edges that show how sharp it is.

use optics_model::descent::DescentEnd;

use super::Target;
use super::edge::{EdgeFrame, EdgeLine, choose, dark_side, place};
use super::lines::{BoardLine, EdgeStretch, number, stretches};
use super::movement::{BoardEdges, check_shake};
use super::pose;
use super::scan::{Contrast, EdgeScan, Run};
use crate::estimate::Estimate;
use crate::refusal::Refusal;
use crate::view::PhotoView;

/// A board in a photograph.
#[derive(Debug, Clone)]
pub(crate) struct LocatedBoard {
    pub edge_frame: EdgeFrame,
    pub edge: EdgeLine,
    /// Relative standard error of lengths in the frame's middle.
    pub scale_std_error: f64,
    /// How the descent to its pose ended.
    pub end: DescentEnd,
    pub corners_px: Vec<[f64; 2]>,
    pub seen: BoardEdges,
}

impl LocatedBoard {
    /// The axis of the photograph that crosses the edge: 0 sideways, 1 up and down.
    pub fn across(&self) -> usize {
        usize::from(self.edge_frame.run == Run::Across)
    }
}

/// Shortest stretch of edge that counts, as a share of the frame's shorter side.
const SHORTEST: f64 = 0.03;

/// Initial distance from an edge to its plateaus, in pixels.
pub(super) const REACH_PX: f64 = 5.0;

/// Largest deviation of a bare board's levels from its black and white, due to uneven light.
const SHARE: f64 = 0.2;

pub(crate) fn find(view: PhotoView<'_>, target: Target) -> Result<LocatedBoard, Refusal> {
    let photo = view.photo;
    let frame = &photo.frame;
    let size = [frame.width() as f64, frame.height() as f64];
    let none = |seen: String| Refusal::NoBoard { label: photo.label.clone(), seen };
    let contrast = Contrast::of(view).ok_or_else(|| none("black and white do not differ enough".into()))?;
    let ([down, across], seen) = look(view, contrast);
    let middle = [0.5 * size[0], 0.5 * size[1]];
    let number = |found: Vec<EdgeStretch>, on: f64| number(found, on).map_err(&none);
    let (down, across) = (number(down, middle[1])?, number(across, middle[0])?);
    if down.is_empty() && across.is_empty() {
        return Err(none("no straight edge".into()));
    }
    let unscaled = |seen: String| Refusal::NoScale { label: photo.label.clone(), seen };
    let fitted = pose::fit(&down, &across, size).map_err(unscaled)?;
    let per_mm = 1.0 / (target.square_mm * fitted.pose.pitch(middle));
    let expected = target.dark_side;
    let (line, stretch) = choose(&down, &across, expected, middle, 2.0 * per_mm)
        .ok_or_else(|| none("no edge has its dark side where `dark_side` gives it".into()))?;
    let found = dark_side(stretch);
    if let Some(expected) = expected.filter(|expected| *expected != found) {
        return Err(Refusal::SidesSwapped { label: photo.label.clone(), found, expected });
    }
    let (edge_frame, edge) = place(&photo.label, line, stretch, fitted.pose, target.square_mm, size)?;
    let corners_px = corners(&down, &across, &fitted.pose, size);
    let pose::FittedPose { scale_std_error, end, .. } = fitted;
    Ok(LocatedBoard { edge_frame, edge, scale_std_error, end, corners_px, seen })
}

/// A straight edge between black and white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeEdge {
    /// Against the frame's columns, or its rows if those are nearer; positive clockwise.
    pub angle_deg: Estimate,
    /// σ of lens and pixel across it; None if it is too short.
    pub blur_px: Option<Estimate>,
}

/// The longest edges of a photograph that run up and down, and across the frame; refuses a photograph with motion blur.
pub(crate) fn free_edges(view: PhotoView<'_>) -> Result<[Option<FreeEdge>; 2], Refusal> {
    let Some(contrast) = Contrast::of(view) else { return Ok([None; 2]) };
    let (_, seen) = look(view, contrast);
    check_shake(&view.photo.label, &seen)?;
    Ok([Run::Down, Run::Across].map(|run| {
        let angle_deg = seen.longest(run)?.angle_deg();
        Some(FreeEdge { angle_deg, blur_px: seen.blur_of(run) })
    }))
}

/// Length of all straight edges between black and white; None if these do not differ enough.
pub(crate) fn free_length_px(view: PhotoView<'_>) -> Option<f64> {
    let (found, _) = look(view, Contrast::of(view)?);
    Some(found.iter().flatten().map(EdgeStretch::length).sum())
}

/// Scans, and repeats with plateaus farther from the edge if it is strongly blurred.
fn look(view: PhotoView<'_>, contrast: Contrast) -> ([Vec<EdgeStretch>; 2], BoardEdges) {
    let shortest = SHORTEST * view.frame().width().min(view.frame().height()) as f64;
    let mut scan = EdgeScan { contrast, reach_px: REACH_PX, share: SHARE };
    loop {
        let found = [Run::Down, Run::Across].map(|run| stretches(&scan.run(view, run), run, shortest));
        let seen = BoardEdges::new(view, scan, [&found[0], &found[1]]);
        let needed = seen.widest().map_or(2.5 * scan.reach_px, |b| (4.5 * b).min(WIDEST_PX));
        if needed <= scan.reach_px * 1.05 || scan.reach_px >= WIDEST_PX {
            return (found, seen);
        }
        scan.reach_px = needed.min(WIDEST_PX);
    }
}

/// Largest distance from an edge to its plateaus, in pixels: a more blurred edge is not used.
const WIDEST_PX: f64 = 40.0;

fn corners(down: &[BoardLine], across: &[BoardLine], pose: &pose::Pose, size: [f64; 2]) -> Vec<[f64; 2]> {
    let pairs = down.iter().flat_map(|d| across.iter().map(move |a| (d.index, a.index)));
    let inside = |px: &[f64; 2]| (0.0..=size[0]).contains(&px[0]) && (0.0..=size[1]).contains(&px[1]);
    pairs.map(|(d, a)| pose.px([f64::from(d), f64::from(a)])).filter(inside).collect()
}
