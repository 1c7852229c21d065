//! Draws a curve for each channel: profiles across one edge with their random errors as bands, or the camera's response to
//! spatial frequencies. Channels differ by the style of their lines as well as by colour.

use crate::drawing::axis::{Axis, extent};
use crate::drawing::canvas::{Canvas, PlotArea, Stroke, at};
use crate::drawing::frame::{AxesFrame, Labels, TICKS_BELOW, tick_width};
use crate::drawing::head::MARGIN;
use crate::drawing::legend::{Key, LegendRow};
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::text::{Anchor, LABEL, Text};

const WIDTH: f64 = 620.0;
const HEIGHT: f64 = 230.0;
/// Half-width of a band, in standard errors.
const WIDE: f64 = 2.0;
/// Red, green and blue; further channels repeat these.
const COLOURS: [Rgb; 3] = [Rgb::VERMILLION, Rgb::GREEN, Rgb::BLUE];

/// The profile of one channel; pixels without a value hold NaN.
#[derive(Debug)]
pub struct EdgeCurve<'a> {
    pub channel: &'a str,
    pub x_mm: &'a [f64],
    pub values: &'a [f64],
    pub std_errors: &'a [f64],
}

/// Profiles on common axes.
pub fn edge_figure(curves: &[EdgeCurve]) -> Picture {
    figure(curves, ["x [mm]", "radiance factor"])
}

/// Responses over frequencies, which are in the place of `x_mm`; without errors.
pub fn sfr_figure(curves: &[EdgeCurve]) -> Picture {
    figure(curves, ["cycles per mm", "response"])
}

/// The line of a channel.
fn pen(i: usize) -> Stroke {
    let colour = COLOURS[i % COLOURS.len()];
    match i % 3 {
        0 => Stroke::solid(colour, 1.4),
        1 => Stroke::dashed(colour, 1.4, &[7, 3]),
        _ => Stroke::dashed(colour, 1.4, &[2, 2]),
    }
}

fn figure(curves: &[EdgeCurve], [x_label, y_label]: [&str; 2]) -> Picture {
    let keys: Vec<Key> =
        curves.iter().enumerate().map(|(i, curve)| Key::line(pen(i), curve.channel)).collect();
    let legend = LegendRow::new(&keys, WIDTH - 2.0 * MARGIN);
    let top = MARGIN + legend.height() + 6.0;
    let area = PlotArea { left: 0.0, top, width: WIDTH, height: HEIGHT };
    let x = Axis::exact(extent(curves.iter().flat_map(|c| c.x_mm.iter().copied())));
    let values = extent(curves.iter().flat_map(|c| c.values.iter().copied()));
    let y = match values {
        Some((low, _)) if low < 0.0 => Axis::around(values, 0.04),
        _ => Axis::from_zero(values),
    };
    let mut frame = AxesFrame { area, x, y };
    frame.area.left = MARGIN + 1.6 * LABEL + tick_width(&frame.y_ticks());
    frame.area.width = WIDTH - MARGIN - frame.area.left;
    let mut canvas = Canvas::new(WIDTH, frame.area.bottom() + TICKS_BELOW + 1.5 * LABEL + MARGIN);
    legend.draw(&mut canvas, frame.area.left, MARGIN);
    frame.rules(&mut canvas);
    for (i, curve) in curves.iter().enumerate() {
        draw_band(&frame, &mut canvas, curve, COLOURS[i % COLOURS.len()]);
    }
    for (i, curve) in curves.iter().enumerate() {
        frame.curve(&mut canvas, curve.x_mm, curve.values, pen(i));
    }
    frame.axes(&mut canvas, Labels { x: true, y: true });
    let middle = frame.area.center();
    let label = |name: &str| Text::new(name, LABEL).anchor(Anchor::Middle);
    canvas.text(at(middle.x, frame.area.bottom() + TICKS_BELOW + 1.2 * LABEL), &label(x_label));
    canvas.text_upwards(at(MARGIN + LABEL, middle.y), &label(y_label));
    canvas.finish()
}

fn draw_band(frame: &AxesFrame, canvas: &mut Canvas, curve: &EdgeCurve, colour: Rgb) {
    let points = curve.x_mm.iter().zip(curve.values).zip(curve.std_errors);
    let points = points.map(|((x, v), e)| (*x, *v, WIDE * e));
    let finite: Vec<_> = points.filter(|(_, v, half)| (v + half).is_finite()).collect();
    let above = finite.iter().map(|(x, v, half)| frame.place(*x, v + half));
    let below = finite.iter().rev().map(|(x, v, half)| frame.place(*x, v - half));
    let outline: Vec<_> = above.chain(below).collect();
    if !outline.is_empty() {
        let tint = colour.tint();
        canvas.polygon(&outline, Some(tint), Stroke::solid(tint, 0.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::assert_shows;

    #[test]
    fn missing_values_are_left_out_of_charts() {
        let x = [-1.0, 0.0, 1.0, 2.0];
        let values = [0.1, f64::NAN, 0.4, 0.5];
        let errors = [0.01, 0.01, f64::NAN, 0.01];
        let curve = |channel| EdgeCurve { channel, x_mm: &x, values: &values, std_errors: &errors };
        let picture = edge_figure(&[curve("R"), curve("G"), curve("B")]);
        assert!(!picture.svg().contains("NaN"), "{}", picture.svg());
        assert_shows(&picture, &["R", "G", "B", "x [mm]"]);
    }
}
