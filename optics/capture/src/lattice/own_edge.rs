//! Finds an edge of another target in the crop, such as chrome on glass, which shows the camera's blur alone.

use super::edge::{EdgeFrame, HALF_CROP_MM};
use crate::calibration::Radiance;
use crate::least_squares::{robust_fit, robust_mean};

/// Strips across the edge, samples across each for its mean, and the tangent of the largest angle to the board's edge.
const STRIPS: usize = 40;
const ACROSS: usize = 12;
const STEEPEST: f64 = 0.2;
/// Steps along a strip in mm.
const STEP_MM: f64 = 0.02;
/// Half of the part in which the edge must lie, and smallest contrast of its sides.
const MIDDLE_MM: f64 = 3.0;
const CONTRAST: f64 = 0.1;

/// The coordinates of the edge; None if no straight edge crosses the crop near that of the board.
pub(crate) fn own_edge(radiance: &Radiance<'_>, board: &EdgeFrame) -> Option<EdgeFrame> {
    let strips = (0..STRIPS).map(|i| (2.0 * (i as f64 + 0.5) / STRIPS as f64 - 1.0) * HALF_CROP_MM);
    let crossings: Vec<StripCrossing> = strips.filter_map(|y| crossing(radiance, board, y)).collect();
    let rising = crossings.iter().filter(|c| c.rises).count();
    let rises = 2 * rising > crossings.len();
    let places = crossings.iter().filter(|c| c.rises == rises);
    let places: Vec<([f64; 2], f64)> = places.map(|c| ([1.0, c.y_mm], c.x_mm)).collect();
    if places.len() * 4 < STRIPS * 3 {
        return None;
    }
    let (found, _) = robust_fit(&places, 10)?;
    let line = [found.x[0], found.x[1]];
    (line[1].abs() < STEEPEST).then(|| board.moved(line, rises))
}

/// Where a strip across the edge has the mean of its sides.
struct StripCrossing {
    x_mm: f64,
    y_mm: f64,
    /// Whether the light side is that of the board.
    rises: bool,
}

fn crossing(radiance: &Radiance<'_>, board: &EdgeFrame, y_mm: f64) -> Option<StripCrossing> {
    let sites = radiance.frame.sites_of(radiance.frame.pattern().sharpest());
    let strip_mm = 2.0 * HALF_CROP_MM / STRIPS as f64;
    let value = |x_mm: f64| {
        let along = |k: usize| y_mm + ((k as f64 + 0.5) / ACROSS as f64 - 0.5) * strip_mm;
        let values = (0..ACROSS).map(|k| {
            let site = sites[k % sites.len()];
            let (x, y) = site.nearest(board.px([x_mm, along(k)]), radiance.frame);
            radiance.sample(site, x, y).value
        });
        values.sum::<f64>() / ACROSS as f64
    };
    let count = (2.0 * HALF_CROP_MM / STEP_MM) as usize;
    let points: Vec<[f64; 2]> =
        (0..=count).map(|i| i as f64 * STEP_MM - HALF_CROP_MM).map(|x| [x, value(x)]).collect();
    let side = |sign: f64| {
        let outer = points.iter().filter(|[x, _]| sign * x > MIDDLE_MM).map(|[_, v]| *v);
        robust_mean(&outer.collect::<Vec<_>>()).0
    };
    let (left, right) = (side(-1.0), side(1.0));
    if (left - right).abs() < CONTRAST {
        return None;
    }
    let level = f64::midpoint(left, right);
    // The mean of all crossings: noise has several.
    let crosses = |pair: &&[[f64; 2]]| (pair[0][1] < level) != (pair[1][1] < level);
    let places: Vec<f64> = points
        .windows(2)
        .filter(|pair| pair[0][0].abs() < MIDDLE_MM)
        .filter(crosses)
        .map(|p| p[0][0] + STEP_MM * (level - p[0][1]) / (p[1][1] - p[0][1]))
        .collect();
    let x_mm = places.iter().sum::<f64>() / places.len() as f64;
    let is_one = !places.is_empty() && places.iter().all(|x| (x - x_mm).abs() < 0.2);
    is_one.then_some(StripCrossing { x_mm, y_mm, rises: right > left })
}
