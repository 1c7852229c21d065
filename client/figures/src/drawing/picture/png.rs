//! Draws shapes as pixels; letters are filled outlines.

use anyhow::Context as _;
use tiny_skia::{
    Color, FillRule, FilterQuality, LineCap, LineJoin, Paint, Path, PathBuilder, Pattern, Pixmap, Rect,
    SpreadMode, StrokeDash, Transform,
};
use ttf_parser::OutlineBuilder;

use super::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::shape::{DOT, Shape, ShapeKind, Stroke, Style};
use crate::drawing::text::{Text, face};

/// The picture with a size in pixels.
pub(super) fn write(picture: &Picture, width: u32, height: u32) -> anyhow::Result<Vec<u8>> {
    let mut canvas = Pixmap::new(width, height)
        .with_context(|| format!("{width} × {height} pixels are too many for PNG: use .svg or .pdf"))?;
    canvas.fill(Color::WHITE);
    let scale = (f64::from(width) / picture.width) as f32;
    let scale = Transform::from_scale(scale, scale);
    for shape in &picture.shapes {
        draw(&mut canvas, shape, scale);
    }
    canvas.encode_png().context("encoding PNG")
}

fn draw(canvas: &mut Pixmap, shape: &Shape, scale: Transform) {
    let Some(outline) = outline(shape) else { return };
    if let ShapeKind::Image(_, pixels) = &shape.kind {
        let area = outline.bounds();
        let [x, y] = [area.width() / pixels.width() as f32, area.height() / pixels.height() as f32];
        let place = Transform::from_row(x, 0.0, 0.0, y, area.left(), area.top());
        let shader = Pattern::new(pixels.as_ref(), SpreadMode::Pad, FilterQuality::Nearest, 1.0, place);
        canvas.fill_rect(area, &Paint { shader, ..Paint::default() }, scale, None);
    }
    if let Some(colour) = shape.fill {
        canvas.fill_path(&outline, &paint(colour), FillRule::Winding, scale, None);
    }
    if let Some(stroke) = shape.visible_stroke() {
        canvas.stroke_path(&outline, &paint(stroke.colour), &pen(stroke), scale, None);
    }
}

fn paint(Rgb(r, g, b): Rgb) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(r, g, b, u8::MAX);
    paint
}

pub(crate) fn pen(stroke: Stroke) -> tiny_skia::Stroke {
    tiny_skia::Stroke {
        width: stroke.width as f32,
        line_cap: if stroke.style == Style::Dots { LineCap::Round } else { LineCap::Butt },
        line_join: LineJoin::Round,
        dash: match stroke.style {
            Style::Dashed(lengths) => StrokeDash::new(lengths.iter().copied().map(f32::from).collect(), 0.0),
            _ => None,
        },
        ..tiny_skia::Stroke::default()
    }
}

/// The path of a shape, without the width of its line; none if it is empty.
pub(crate) fn outline(shape: &Shape) -> Option<Path> {
    let is_dots = shape.stroke.is_some_and(|stroke| stroke.style == Style::Dots);
    match &shape.kind {
        ShapeKind::Rectangle(area) | ShapeKind::Image(area, _) => {
            let [x, y, width, height] = [area.left, area.top, area.width, area.height].map(|l| l as f32);
            Rect::from_xywh(x, y, width, height).map(PathBuilder::from_rect)
        }
        ShapeKind::Line(points) | ShapeKind::Polygon(points) => {
            let mut path = PathBuilder::new();
            for (i, (x, y)) in points.iter().map(|point| (point.x as f32, point.y as f32)).enumerate() {
                if i == 0 || is_dots {
                    path.move_to(x, y);
                }
                path.line_to(if is_dots { x + DOT as f32 } else { x }, y);
            }
            if matches!(shape.kind, ShapeKind::Polygon(_)) {
                path.close();
            }
            path.finish()
        }
        ShapeKind::Circle(center, radius) => {
            PathBuilder::from_circle(center.x as f32, center.y as f32, *radius as f32)
        }
        ShapeKind::Text(at, text) => letters(text, Transform::from_translate(at.x as f32, at.y as f32)),
        ShapeKind::TextUpwards(at, text) => {
            letters(text, Transform::from_row(0.0, -1.0, 1.0, 0.0, at.x as f32, at.y as f32))
        }
    }
}

fn letters(text: &Text, place: Transform) -> Option<Path> {
    let face = face(text.bold);
    let mut letters = PathBuilder::new();
    for glyph in text.glyphs() {
        let mut outline = GlyphOutline(PathBuilder::new());
        face.outline_glyph(glyph.id, &mut outline);
        let scale = (glyph.size / f64::from(face.units_per_em())) as f32;
        let place = place.pre_translate(glyph.left as f32, glyph.drop as f32).pre_scale(scale, -scale);
        if let Some(outline) = outline.0.finish().and_then(|outline| outline.transform(place)) {
            letters.push_path(&outline);
        }
    }
    letters.finish()
}

/// The outline of a glyph in units of its font.
struct GlyphOutline(PathBuilder);

impl OutlineBuilder for GlyphOutline {
    fn move_to(&mut self, x: f32, y: f32) {
        self.0.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.0.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.0.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.0.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.0.close();
    }
}
