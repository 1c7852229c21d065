//! What is marked on the maps, and the legend for it.

use super::{MapFigure, MapPanel, MapPoint};
use crate::plot::canvas::{Canvas, at};
use crate::plot::color::Color;
use crate::plot::frame::Frame;
use crate::plot::legend::{Key, Mark, Sample};

/// Marks for places outside stand this far from the border.
const INSET: f64 = 9.0;

/// The legend for the marks that occur.
pub(super) fn keys(figure: &MapFigure, frame: &Frame) -> Vec<Key> {
    let mut keys = Vec::new();
    if figure.panels.iter().any(|panel| panel.best.is_some()) {
        keys.push(Key::mark(Mark::Cross, "best fit"));
    }
    keys.push(Key::mark(Mark::Circle, "best fit for this g"));
    let predicted = || figure.panels.iter().filter_map(|panel| panel.predicted);
    if predicted().any(|point| beyond(frame, point) == (0, 0)) {
        keys.push(Key::mark(Mark::Diamond, "similarity theory"));
    }
    if predicted().any(|point| beyond(frame, point) != (0, 0)) {
        keys.push(Key::mark(Mark::Arrow(0), "similarity theory, outside the grid"));
    }
    if figure.panels.iter().flat_map(|panel| &panel.distance).any(|d| !d.is_finite()) {
        keys.push(Key { sample: Sample::Patch(Color::NO_DATA), label: "no record".into() });
    }
    if figure.albedo.iter().any(|&albedo| albedo >= 1.0) {
        keys.push(Key::note("α = 1 has no place on the logarithmic axis"));
    }
    keys
}

pub(super) fn marks(canvas: &mut Canvas, frame: &Frame, panel: &MapPanel) {
    mark(canvas, frame, Mark::Circle, panel.best_of_g);
    if let Some(point) = panel.predicted {
        mark(canvas, frame, Mark::Diamond, point);
    }
    if let Some(point) = panel.best {
        mark(canvas, frame, Mark::Cross, point);
    }
}

/// Marks a point, or draws an arrow at the border if it is outside.
fn mark(canvas: &mut Canvas, frame: &Frame, mark: Mark, point: MapPoint) {
    if point.albedo.is_nan() || point.sigma_t_per_mm.is_nan() {
        return;
    }
    let (right, up) = beyond(frame, point);
    if (right, up) == (0, 0) {
        return mark.draw(canvas, frame.place(1.0 - point.albedo, point.sigma_t_per_mm));
    }
    let area = frame.area;
    let along = |side: i8, inside: f64, low: f64, high: f64| match side {
        0 => inside.clamp(low + INSET, high - INSET),
        1 => high - INSET,
        _ => low + INSET,
    };
    let x = along(right, frame.across(1.0 - point.albedo), area.left, area.right());
    let y = along(-up, frame.up(point.sigma_t_per_mm), area.top, area.bottom());
    Mark::Arrow(eighths(right, up)).draw(canvas, at(x, y));
}

/// On which side of the axes a point lies, to the right and up: −1, 0 or 1 each.
fn beyond(frame: &Frame, point: MapPoint) -> (i8, i8) {
    let side = |fraction: f64| i8::from(fraction > 1.0) - i8::from(fraction < 0.0);
    // The logarithm of zero is −∞, which is outside as it should be.
    let co_albedo = (1.0 - point.albedo).max(0.0);
    (side(frame.x.fraction(co_albedo)), side(frame.y.fraction(point.sigma_t_per_mm.max(0.0))))
}

/// The direction in eighths of a turn, clockwise from the right.
fn eighths(right: i8, up: i8) -> u8 {
    let turn = f64::from(-up).atan2(f64::from(right)) / std::f64::consts::FRAC_PI_4;
    turn.round().rem_euclid(8.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::axis::Axis;
    use crate::plot::canvas::Area;

    #[test]
    fn arrows_point_to_where_the_point_is() {
        let area = Area { left: 10.0, top: 10.0, width: 100.0, height: 100.0 };
        let frame = Frame { area, x: Axis::logarithmic(1e-5, 0.9), y: Axis::logarithmic(1.0, 30.0) };
        let side = |sigma_t_per_mm, albedo| beyond(&frame, MapPoint { sigma_t_per_mm, albedo });
        assert_eq!(side(5.0, 0.9), (0, 0));
        assert_eq!(side(50.0, 0.9), (0, 1));
        assert_eq!(side(5.0, 1.0), (-1, 0));
        assert_eq!(side(0.5, 0.01), (1, -1));
        assert_eq!(side(0.0, 0.9), (0, -1));
        let ways = [(1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1)];
        assert_eq!(ways.map(|(right, up)| eighths(right, up)), [0, 1, 2, 3, 4, 5, 6, 7]);
    }
}
