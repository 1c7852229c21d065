//! Draws legends: a sample of each line or mark with its label.

use super::canvas::{Canvas, CanvasPoint, PlotArea, Stroke, at};
use super::rgb::Rgb;
use super::text::{SMALL, Text};

const SAMPLE: f64 = 22.0;
const GAP: f64 = 6.0;
const BETWEEN: f64 = 18.0;
const LINE: f64 = 1.45 * SMALL;

/// One entry of a legend.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Key {
    pub(crate) sample: KeySample,
    pub(crate) label: String,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum KeySample {
    Line(Stroke),
    Mark(Mark),
    Patch(Rgb),
    /// A label without a sample.
    None,
}

/// Marks at a point, with a white rim that keeps them visible on any background.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mark {
    Cross,
    Circle,
    Diamond,
    Dot,
    /// Points to the outside of an axis, in the direction of a unit vector in eighths of a turn, clockwise from the right.
    Arrow(u8),
}

impl Key {
    pub(crate) fn line(stroke: Stroke, label: impl Into<String>) -> Self {
        Self { sample: KeySample::Line(stroke), label: label.into() }
    }

    pub(crate) fn mark(mark: Mark, label: impl Into<String>) -> Self {
        Self { sample: KeySample::Mark(mark), label: label.into() }
    }

    pub(crate) fn note(label: impl Into<String>) -> Self {
        Self { sample: KeySample::None, label: label.into() }
    }

    fn text(&self) -> Text {
        let colour = if self.sample == KeySample::None { Rgb::FAINT_INK } else { Rgb::INK };
        Text::new(self.label.as_str(), SMALL).colour(colour)
    }

    fn indent(&self) -> f64 {
        if self.sample == KeySample::None { 0.0 } else { SAMPLE + GAP }
    }

    fn draw_sample(&self, canvas: &mut Canvas, left: f64, baseline: f64) {
        let middle = baseline - 0.36 * SMALL;
        match self.sample {
            KeySample::Line(stroke) => {
                let points: Vec<_> = (0..6).map(|i| at(left + SAMPLE * f64::from(i) / 5.0, middle)).collect();
                canvas.polyline(&points, stroke);
            }
            KeySample::Mark(mark) => mark.draw(canvas, at(left + SAMPLE / 2.0, middle)),
            KeySample::Patch(colour) => {
                canvas.fill(
                    PlotArea { left: left + 4.0, top: middle - 5.0, width: SAMPLE - 8.0, height: 10.0 },
                    colour,
                );
            }
            KeySample::None => {}
        }
    }
}

/// Keys in lines one below the other, long words wrapped.
#[derive(Debug)]
pub(crate) struct LegendColumn<'a> {
    keys: &'a [Key],
    width: f64,
}

impl<'a> LegendColumn<'a> {
    pub(crate) fn new(keys: &'a [Key], width: f64) -> Self {
        Self { keys, width }
    }

    pub(crate) fn height(&self) -> f64 {
        LINE * self.keys.iter().map(|key| self.lines(key).len()).sum::<usize>() as f64
    }

    pub(crate) fn draw(&self, canvas: &mut Canvas, left: f64, top: f64) {
        let mut baseline = top + SMALL;
        for key in self.keys {
            key.draw_sample(canvas, left, baseline);
            for line in self.lines(key) {
                canvas.text(at(left + key.indent(), baseline), &line);
                baseline += LINE;
            }
        }
    }

    fn lines(&self, key: &Key) -> Vec<Text> {
        key.text().wrapped(self.width - key.indent())
    }
}

/// Keys side by side, in as many rows as they need.
#[derive(Debug)]
pub(crate) struct LegendRow<'a> {
    keys: &'a [Key],
    width: f64,
}

impl<'a> LegendRow<'a> {
    pub(crate) fn new(keys: &'a [Key], width: f64) -> Self {
        Self { keys, width }
    }

    pub(crate) fn height(&self) -> f64 {
        self.places().last().map_or(0.0, |(_, row, _)| LINE * (row + 1) as f64)
    }

    pub(crate) fn draw(&self, canvas: &mut Canvas, left: f64, top: f64) {
        for (offset, row, key) in self.places() {
            let baseline = top + SMALL + LINE * row as f64;
            key.draw_sample(canvas, left + offset, baseline);
            let text = key.text().fitted(self.width - key.indent());
            canvas.text(at(left + offset + key.indent(), baseline), &text);
        }
    }

    /// Offset from the left, and the row, of each key.
    fn places(&self) -> Vec<(f64, usize, &'a Key)> {
        let (mut offset, mut row) = (0.0, 0);
        let mut places = Vec::with_capacity(self.keys.len());
        for key in self.keys {
            let width = key.indent() + key.text().width();
            if offset > 0.0 && offset + width > self.width {
                (offset, row) = (0.0, row + 1);
            }
            places.push((offset, row, key));
            offset += width + BETWEEN;
        }
        places
    }
}

impl Mark {
    pub(crate) fn draw(self, canvas: &mut Canvas, place: CanvasPoint) {
        let rim = Stroke::solid(Rgb::WHITE, self.width() + 2.4);
        self.outline(canvas, place, rim);
        self.outline(canvas, place, Stroke::solid(self.colour(), self.width()));
    }

    fn colour(self) -> Rgb {
        match self {
            Self::Cross | Self::Dot => Rgb::VERMILLION,
            Self::Circle => Rgb::INK,
            Self::Diamond | Self::Arrow(_) => Rgb::ORANGE,
        }
    }

    fn width(self) -> f64 {
        if self == Self::Cross { 2.4 } else { 1.7 }
    }

    fn outline(self, canvas: &mut Canvas, CanvasPoint { x, y }: CanvasPoint, stroke: Stroke) {
        let rim = if stroke.colour == Rgb::WHITE { 1.2 } else { 0.0 };
        match self {
            Self::Cross => {
                let arm = 10.0 + rim;
                canvas.line(at(x - arm, y), at(x + arm, y), stroke);
                canvas.line(at(x, y - arm), at(x, y + arm), stroke);
            }
            Self::Circle => canvas.circle(at(x, y), 6.5, None, stroke),
            Self::Dot => canvas.circle(at(x, y), 3.2, Some(stroke.colour), stroke),
            Self::Diamond => {
                let r = 4.6;
                canvas.polygon(&[at(x - r, y), at(x, y - r), at(x + r, y), at(x, y + r)], None, stroke);
            }
            Self::Arrow(eighths) => {
                let turn = f64::from(eighths) * std::f64::consts::FRAC_PI_4;
                let tip =
                    |angle: f64, r: f64| at(x + r * libm::cos(turn + angle), y + r * libm::sin(turn + angle));
                canvas.polygon(&[tip(0.0, 6.5), tip(2.4, 6.0), tip(-2.4, 6.0)], Some(stroke.colour), stroke);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Keys continue in the next row when one is full.
    #[test]
    fn keys_continue_in_the_next_row() {
        let keys: Vec<_> = (0..7).map(|i| Key::note(format!("entry number {i}"))).collect();
        let row = LegendRow::new(&keys, 250.0);
        let rows: Vec<_> = row.places().into_iter().map(|(_, row, _)| row).collect();
        assert_eq!(rows, [0, 0, 1, 1, 2, 2, 3]);
        assert!((row.height() - 4.0 * LINE).abs() < 1e-9);
        assert_eq!(LegendRow::new(&[], 250.0).height(), 0.0);
    }
}
