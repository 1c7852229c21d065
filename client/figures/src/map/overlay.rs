//! Draws the marks on the maps, and their legend.

use optics_model::Medium;
use optics_model::fit::{DistanceMap, MapLayer};

use super::MapLabels;
use crate::drawing::canvas::{Canvas, at};
use crate::drawing::frame::AxesFrame;
use crate::drawing::legend::{Key, KeySample, Mark};
use crate::drawing::rgb::Rgb;

/// Distance from the border of marks for media outside the axes.
const INSET: f64 = 9.0;

/// The legend for the marks that occur.
pub(super) fn keys(words: &MapLabels, map: &DistanceMap, frame: &AxesFrame) -> Vec<Key> {
    let mut keys = vec![Key::mark(Mark::Cross, words.mark_of_all), Key::mark(Mark::Circle, words.mark)];
    let similar = || map.layers.iter().filter_map(|layer| layer.similar);
    if similar().any(|medium| beyond(frame, &medium) == (0, 0)) {
        keys.push(Key::mark(Mark::Diamond, "similarity theory"));
    }
    if similar().any(|medium| beyond(frame, &medium) != (0, 0)) {
        keys.push(Key::mark(Mark::Arrow(0), "similarity theory, outside the grid"));
    }
    if map.layers.iter().flat_map(|layer| &layer.errors).flatten().any(|d| !d.is_finite()) {
        keys.push(Key { sample: KeySample::Patch(Rgb::NO_DATA), label: "no record".into() });
    }
    if map.albedo.iter().any(|&albedo| albedo >= 1.0) {
        keys.push(Key::note("α = 1 has no place on the logarithmic axis"));
    }
    keys
}

pub(super) fn marks(canvas: &mut Canvas, frame: &AxesFrame, layer: &MapLayer, best_of_all: bool) {
    mark(canvas, frame, Mark::Circle, &layer.best.medium);
    if let Some(medium) = &layer.similar {
        mark(canvas, frame, Mark::Diamond, medium);
    }
    if best_of_all {
        mark(canvas, frame, Mark::Cross, &layer.best.medium);
    }
}

/// Marks a medium, or draws an arrow at the border if it is outside.
fn mark(canvas: &mut Canvas, frame: &AxesFrame, mark: Mark, medium: &Medium) {
    let (right, up) = beyond(frame, medium);
    if (right, up) == (0, 0) {
        return mark.draw(canvas, frame.place(1.0 - medium.albedo(), medium.sigma_t_per_mm()));
    }
    let area = frame.area;
    let along = |side: i8, inside: f64, low: f64, high: f64| match side {
        0 => inside.clamp(low + INSET, high - INSET),
        1 => high - INSET,
        _ => low + INSET,
    };
    let x = along(right, frame.across(1.0 - medium.albedo()), area.left, area.right());
    let y = along(-up, frame.up(medium.sigma_t_per_mm()), area.top, area.bottom());
    Mark::Arrow(eighths(right, up)).draw(canvas, at(x, y));
}

/// The side of the axes on which a medium lies, to the right and up: −1, 0 or 1 each.
fn beyond(frame: &AxesFrame, medium: &Medium) -> (i8, i8) {
    let side = |fraction: f64| i8::from(fraction > 1.0) - i8::from(fraction < 0.0);
    // The logarithm of zero is −∞, which is outside the axes.
    (side(frame.x.fraction(1.0 - medium.albedo())), side(frame.y.fraction(medium.sigma_t_per_mm())))
}

/// The direction in eighths of a turn, clockwise from the right.
fn eighths(right: i8, up: i8) -> u8 {
    let turn = libm::atan2(f64::from(-up), f64::from(right)) / std::f64::consts::FRAC_PI_4;
    turn.round().rem_euclid(8.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::axis::Axis;
    use crate::drawing::canvas::PlotArea;

    #[test]
    fn arrows_point_to_where_the_point_is() {
        let area = PlotArea { left: 10.0, top: 10.0, width: 100.0, height: 100.0 };
        let frame = AxesFrame { area, x: Axis::logarithmic(1e-5, 0.9), y: Axis::logarithmic(1.0, 30.0) };
        let side = |sigma_t, albedo| beyond(&frame, &Medium::new(sigma_t, albedo, 0.0).unwrap());
        assert_eq!(side(5.0, 0.9), (0, 0));
        assert_eq!(side(50.0, 0.9), (0, 1));
        assert_eq!(side(5.0, 1.0), (-1, 0));
        assert_eq!(side(0.5, 0.01), (1, -1));
        assert_eq!(side(1e-6, 0.9), (0, -1));
        let ways = [(1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1)];
        assert_eq!(ways.map(|(right, up)| eighths(right, up)), [0, 1, 2, 3, 4, 5, 6, 7]);
    }
}
