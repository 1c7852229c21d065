//! Draws one set of axes with its curves.

use super::axis::{Axis, AxisDirection, Tick};
use super::canvas::{Canvas, CanvasPoint, PlotArea, Stroke, Style, at};
use super::curve::pieces;
use super::rgb::Rgb;
use super::text::{Anchor, TICK, Text};

const TICK_LENGTH: f64 = 3.5;
const GAP: f64 = 2.5;

/// Distance from the axis down to the bottom of its tick labels.
pub(crate) const TICKS_BELOW: f64 = TICK_LENGTH + GAP + TICK;

/// Distance from the start of the widest tick label to the axis.
pub(crate) fn tick_width(ticks: &[Tick]) -> f64 {
    let widths =
        ticks.iter().filter_map(|tick| tick.label.as_ref()).map(|label| Text::new(label, TICK).width());
    TICK_LENGTH + GAP + widths.fold(0.0, f64::max)
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct AxesFrame {
    pub(crate) area: PlotArea,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
}

/// Whether each axis has tick labels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Labels {
    pub(crate) x: bool,
    pub(crate) y: bool,
}

impl AxesFrame {
    pub(crate) fn place(&self, x: f64, y: f64) -> CanvasPoint {
        at(self.across(x), self.up(y))
    }

    pub(crate) fn across(&self, x: f64) -> f64 {
        self.area.left + self.area.width * self.x.fraction(x)
    }

    pub(crate) fn up(&self, y: f64) -> f64 {
        self.area.bottom() - self.area.height * self.y.fraction(y)
    }

    pub(crate) fn x_ticks(&self) -> Vec<Tick> {
        self.x.ticks(self.area.width, AxisDirection::Across)
    }

    pub(crate) fn y_ticks(&self) -> Vec<Tick> {
        self.y.ticks(self.area.height, AxisDirection::Up)
    }

    /// Light rules at the labelled ticks, to be drawn below all else.
    pub(crate) fn rules(&self, canvas: &mut Canvas) {
        let rule = Stroke::solid(Rgb::RULE, 0.7);
        for tick in self.x_ticks().iter().filter(|tick| tick.label.is_some()) {
            let x = self.across(tick.value);
            canvas.line(at(x, self.area.top), at(x, self.area.bottom()), rule);
        }
        for tick in self.y_ticks().iter().filter(|tick| tick.label.is_some()) {
            let y = self.up(tick.value);
            canvas.line(at(self.area.left, y), at(self.area.right(), y), rule);
        }
    }

    /// Axis lines on the left and below, with ticks.
    pub(crate) fn axes(&self, canvas: &mut Canvas, labels: Labels) {
        let PlotArea { left, top, .. } = self.area;
        let (right, bottom) = (self.area.right(), self.area.bottom());
        let pen = Stroke::solid(Rgb::AXIS, 0.8);
        canvas.polyline(&[at(left, top), at(left, bottom), at(right, bottom)], pen);
        for tick in self.x_ticks() {
            let x = self.across(tick.value);
            canvas.line(at(x, bottom), at(x, bottom + tick_length(&tick)), pen);
            if let Some(label) = tick.label.filter(|_| labels.x) {
                let text = Text::new(label, TICK).anchor(Anchor::Middle);
                canvas.text(at(x, bottom + TICKS_BELOW - 0.15 * TICK), &text);
            }
        }
        for tick in self.y_ticks() {
            let y = self.up(tick.value);
            canvas.line(at(left - tick_length(&tick), y), at(left, y), pen);
            if let Some(label) = tick.label.filter(|_| labels.y) {
                let text = Text::new(label, TICK).anchor(Anchor::End);
                canvas.text(at(left - TICK_LENGTH - GAP, y + 0.36 * TICK), &text);
            }
        }
    }

    /// A box with ticks on its right, for a colour bar.
    pub(crate) fn scale_on_the_right(&self, canvas: &mut Canvas) {
        let PlotArea { left, top, .. } = self.area;
        let (right, bottom) = (self.area.right(), self.area.bottom());
        let pen = Stroke::solid(Rgb::AXIS, 0.8);
        canvas.polygon(&[at(left, top), at(right, top), at(right, bottom), at(left, bottom)], None, pen);
        for tick in self.y_ticks() {
            let y = self.up(tick.value);
            canvas.line(at(right, y), at(right + tick_length(&tick), y), pen);
            if let Some(label) = tick.label {
                canvas.text(at(right + TICK_LENGTH + GAP, y + 0.36 * TICK), &Text::new(label, TICK));
            }
        }
    }

    /// The two sides that have no ticks.
    pub(crate) fn close(&self, canvas: &mut Canvas) {
        let (right, bottom) = (self.area.right(), self.area.bottom());
        let corners = [at(self.area.left, self.area.top), at(right, self.area.top), at(right, bottom)];
        canvas.polyline(&corners, Stroke::solid(Rgb::AXIS, 0.8));
    }

    /// A curve or its points; a value alone between missing ones becomes a dot.
    pub(crate) fn curve(&self, canvas: &mut Canvas, x: &[f64], y: &[f64], stroke: Stroke) {
        let points = x.iter().zip(y).map(|(&x, &y)| self.place(x, y));
        if stroke.style == Style::Dots {
            let finite: Vec<_> = points.filter(|point| point.x.is_finite() && point.y.is_finite()).collect();
            return canvas.polyline(&finite, stroke);
        }
        for piece in pieces(points) {
            match piece[..] {
                [point] => {
                    canvas.circle(
                        point,
                        stroke.width,
                        Some(stroke.colour),
                        Stroke::solid(stroke.colour, 0.0),
                    );
                }
                _ => canvas.polyline(&piece, stroke),
            }
        }
    }
}

fn tick_length(tick: &Tick) -> f64 {
    if tick.label.is_some() { TICK_LENGTH } else { 0.55 * TICK_LENGTH }
}
