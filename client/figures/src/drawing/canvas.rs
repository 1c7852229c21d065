//! A drawing under construction, to which figures add shapes.

use tiny_skia::Pixmap;

use super::picture::Picture;
use super::rgb::Rgb;
pub(crate) use super::shape::{CanvasPoint, PlotArea, Stroke, Style, at};
use super::shape::{Shape, ShapeKind};
use super::text::Text;

/// A drawing under construction. Later shapes are drawn above earlier ones.
#[derive(Debug)]
pub(crate) struct Canvas {
    width: f64,
    height: f64,
    shapes: Vec<Shape>,
}

impl Canvas {
    pub(crate) fn new(width: f64, height: f64) -> Self {
        Self { width: width.ceil(), height: height.ceil(), shapes: Vec::new() }
    }

    pub(crate) fn fill(&mut self, area: PlotArea, colour: Rgb) {
        self.add(ShapeKind::Rectangle(area), Some(colour), None);
    }

    pub(crate) fn line(&mut self, from: CanvasPoint, to: CanvasPoint, stroke: Stroke) {
        self.polyline(&[from, to], stroke);
    }

    pub(crate) fn polyline(&mut self, points: &[CanvasPoint], stroke: Stroke) {
        self.add(ShapeKind::Line(points.to_vec()), None, Some(stroke));
    }

    pub(crate) fn polygon(&mut self, points: &[CanvasPoint], fill: Option<Rgb>, stroke: Stroke) {
        self.add(ShapeKind::Polygon(points.to_vec()), fill, Some(stroke));
    }

    pub(crate) fn circle(&mut self, center: CanvasPoint, radius: f64, fill: Option<Rgb>, stroke: Stroke) {
        self.add(ShapeKind::Circle(center, radius), fill, Some(stroke));
    }

    /// Text with its baseline at a point.
    pub(crate) fn text(&mut self, place: CanvasPoint, text: &Text) {
        self.add(ShapeKind::Text(place, text.clone()), Some(text.colour), None);
    }

    /// Text that reads upwards, its baseline through a point.
    pub(crate) fn text_upwards(&mut self, place: CanvasPoint, text: &Text) {
        self.add(ShapeKind::TextUpwards(place, text.clone()), Some(text.colour), None);
    }

    /// Pixels stretched over an area without smoothing.
    pub(crate) fn image(&mut self, area: PlotArea, pixels: Pixmap) {
        self.add(ShapeKind::Image(area, pixels), None, None);
    }

    fn add(&mut self, kind: ShapeKind, fill: Option<Rgb>, stroke: Option<Stroke>) {
        self.shapes.push(Shape { kind, fill, stroke });
    }

    pub(crate) fn finish(self) -> Picture {
        Picture { shapes: self.shapes, width: self.width, height: self.height }
    }
}
