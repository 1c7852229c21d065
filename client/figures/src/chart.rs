//! Draws a chart of patches: measured against predicted radiance factors, and the differences in standard errors.

use crate::drawing::axis::{Axis, extent};
use crate::drawing::canvas::{Canvas, PlotArea, Stroke, at};
use crate::drawing::frame::{AxesFrame, Labels, TICKS_BELOW, tick_width};
use crate::drawing::head::MARGIN;
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::text::{Anchor, LABEL, Text};

const WIDTH: f64 = 420.0;
const HEIGHTS: [f64; 2] = [380.0, 120.0];
const GAP: f64 = 14.0;
const RADIUS: f64 = 2.6;
/// Standard errors within which 95 % of the differences lie.
const BAND: f64 = 2.0;

/// A patch in one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChartPoint {
    pub predicted: f64,
    pub measured: f64,
    /// Standard error of the difference.
    pub std_error: f64,
}

/// None without points.
pub fn chart_figure(points: &[ChartPoint]) -> Option<Picture> {
    let values = extent(points.iter().flat_map(|p| [p.predicted, p.measured]))?;
    let x = Axis::around(Some(values), 0.02);
    let z = |p: &ChartPoint| (p.measured - p.predicted) / p.std_error.max(f64::MIN_POSITIVE);
    let most = points.iter().map(|p| z(p).abs()).fold(BAND, f64::max);
    let frame = |top: f64, height: f64, y| AxesFrame {
        area: PlotArea { left: 0.0, top, width: WIDTH, height },
        x,
        y,
    };
    let mut frames = [
        frame(MARGIN, HEIGHTS[0], x),
        frame(MARGIN + HEIGHTS[0] + GAP, HEIGHTS[1], Axis::around(Some((-most, most)), 0.1)),
    ];
    let ticks = frames.iter().map(|frame| tick_width(&frame.y_ticks())).fold(0.0, f64::max);
    let left = MARGIN + 1.6 * LABEL + ticks;
    for frame in &mut frames {
        (frame.area.left, frame.area.width) = (left, WIDTH - MARGIN - left);
    }
    let [above, below] = &frames;
    let bottom = below.area.bottom();
    let mut canvas = Canvas::new(WIDTH, bottom + TICKS_BELOW + 1.5 * LABEL + MARGIN);
    for frame in &frames {
        frame.rules(&mut canvas);
    }
    let faint = Stroke::solid(Rgb::INK, 0.8);
    let ends = [0.0, 1.0].map(|end| x.value(end));
    above.curve(&mut canvas, &ends, &ends, faint);
    for level in [-BAND, BAND] {
        below.curve(&mut canvas, &ends, &[level; 2], Stroke::dashed(Rgb::INK, 0.8, &[4, 3]));
    }
    for point in points {
        let is_far = z(point).abs() > 3.0;
        let colour = if is_far { Rgb::VERMILLION } else { Rgb::BLUE };
        let (low, high) = (point.measured - BAND * point.std_error, point.measured + BAND * point.std_error);
        let inside = |v: f64| v.clamp(ends[0], ends[1]);
        let bar = [low, high].map(|v| above.place(point.predicted, inside(v)));
        canvas.line(bar[0], bar[1], Stroke::solid(colour, 1.0));
        for place in [above.place(point.predicted, point.measured), below.place(point.predicted, z(point))] {
            canvas.circle(place, RADIUS, is_far.then_some(colour), Stroke::solid(colour, 1.2));
        }
    }
    above.axes(&mut canvas, Labels { x: false, y: true });
    below.axes(&mut canvas, Labels { x: true, y: true });
    for (frame, label) in [(above, "measured radiance factor"), (below, "difference [σ]")] {
        let label = Text::new(label, LABEL).anchor(Anchor::Middle);
        canvas.text_upwards(at(MARGIN + LABEL, frame.area.center().y), &label);
    }
    let label = Text::new("predicted radiance factor; bars: ± 2 σ", LABEL).anchor(Anchor::Middle);
    canvas.text(at(above.area.center().x, bottom + TICKS_BELOW + 1.2 * LABEL), &label);
    Some(canvas.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::assert_shows;

    /// Both panels are labelled; a patch beyond three standard errors is a filled mark.
    #[test]
    fn charts_show_far_patches() {
        let point = |predicted: f64, z: f64| ChartPoint {
            predicted,
            measured: predicted + 0.01 * z,
            std_error: 0.01,
        };
        let picture = chart_figure(&[point(0.2, 0.5), point(0.5, -1.0), point(0.8, 4.0)]).unwrap();
        assert_shows(
            &picture,
            &["measured radiance factor", "difference [σ]", "predicted radiance factor; bars: ± 2 σ"],
        );
        assert!(chart_figure(&[]).is_none());
    }
}
