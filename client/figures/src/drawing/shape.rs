//! The shapes that a drawing consists of: areas, lines, circles, images of pixels, and texts. Every format of a picture
//! is written from them.

use tiny_skia::Pixmap;

use super::rgb::Rgb;
use super::text::Text;

/// A point on the canvas: pixels to the right and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CanvasPoint {
    pub(crate) x: f64,
    pub(crate) y: f64,
}

/// A point of the canvas; the name is short because it is used often.
pub(crate) const fn at(x: f64, y: f64) -> CanvasPoint {
    CanvasPoint { x, y }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlotArea {
    pub(crate) left: f64,
    pub(crate) top: f64,
    pub(crate) width: f64,
    pub(crate) height: f64,
}

impl PlotArea {
    pub(crate) fn right(&self) -> f64 {
        self.left + self.width
    }

    pub(crate) fn bottom(&self) -> f64 {
        self.top + self.height
    }

    pub(crate) fn center(&self) -> CanvasPoint {
        at(self.left + self.width / 2.0, self.top + self.height / 2.0)
    }
}

/// A line's colour, width and style.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stroke {
    pub(crate) colour: Rgb,
    pub(crate) width: f64,
    pub(crate) style: Style,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Style {
    Solid,
    /// Lengths of dashes and gaps.
    Dashed(&'static [u8]),
    /// A dot at every point and nothing between.
    Dots,
}

impl Stroke {
    pub(crate) const fn solid(colour: Rgb, width: f64) -> Self {
        Self { colour, width, style: Style::Solid }
    }

    pub(crate) const fn dashed(colour: Rgb, width: f64, dashes: &'static [u8]) -> Self {
        Self { colour, width, style: Style::Dashed(dashes) }
    }

    pub(crate) const fn dots(colour: Rgb, width: f64) -> Self {
        Self { colour, width, style: Style::Dots }
    }
}

/// Length of the dashes that round caps turn into dots.
pub(crate) const DOT: f64 = 0.01;

/// A kind of shape with the colour of its inside and its line.
#[derive(Clone, Debug)]
pub(crate) struct Shape {
    pub(crate) kind: ShapeKind,
    pub(crate) fill: Option<Rgb>,
    pub(crate) stroke: Option<Stroke>,
}

#[derive(Clone, Debug)]
pub(crate) enum ShapeKind {
    Rectangle(PlotArea),
    Line(Vec<CanvasPoint>),
    Polygon(Vec<CanvasPoint>),
    /// Center and radius.
    Circle(CanvasPoint, f64),
    /// Pixels stretched over an area without smoothing.
    Image(PlotArea, Pixmap),
    /// Text with its baseline through a point, to the right.
    Text(CanvasPoint, Text),
    /// Text that reads upwards.
    TextUpwards(CanvasPoint, Text),
}

impl Shape {
    /// The line, if it has a width.
    pub(crate) fn visible_stroke(&self) -> Option<Stroke> {
        self.stroke.filter(|stroke| stroke.width > 0.0)
    }
}
