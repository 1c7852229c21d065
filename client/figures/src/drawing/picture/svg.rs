//! Writes shapes as SVG text, one element for each.

use std::fmt::Write as _;

use base64::Engine as _;

use super::Picture;
use crate::drawing::number::short;
use crate::drawing::rgb::Rgb;
use crate::drawing::shape::{CanvasPoint, DOT, PlotArea, Shape, ShapeKind, Stroke, Style};
use crate::drawing::text::{Anchor, Level, Text, drawn, spans};

/// The SVG with a width and a height, which may have units.
pub(super) fn write(picture: &Picture, width: &str, height: &str) -> String {
    let (w, h, white) = (short(picture.width), short(picture.height), Rgb::WHITE);
    let mut svg = format!(
        r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {w} {h}" font-family="'DejaVu Sans', Verdana, sans-serif">
<rect width="{w}" height="{h}" fill="{white}"/>
"#
    );
    for shape in &picture.shapes {
        svg.push_str(&element(shape));
        svg.push('\n');
    }
    svg + "</svg>\n"
}

fn element(shape: &Shape) -> String {
    let fill = shape.fill.map_or_else(|| "none".to_owned(), |colour| colour.to_string());
    let pen = shape.stroke.map(pen).unwrap_or_default();
    let is_dots = shape.stroke.is_some_and(|stroke| stroke.style == Style::Dots);
    match &shape.kind {
        ShapeKind::Rectangle(area) => format!(r#"<rect {} fill="{fill}"/>"#, place(area)),
        ShapeKind::Line(points) if is_dots => format!(r#"<path d="{}" fill="{fill}" {pen}/>"#, dots(points)),
        ShapeKind::Line(points) => format!(r#"<path d="{}" fill="{fill}" {pen}/>"#, path(points)),
        ShapeKind::Polygon(points) => format!(r#"<path d="{}Z" fill="{fill}" {pen}/>"#, path(points)),
        ShapeKind::Circle(center, radius) => {
            let [x, y, r] = [center.x, center.y, *radius].map(short);
            format!(r#"<circle cx="{x}" cy="{y}" r="{r}" fill="{fill}" {pen}/>"#)
        }
        ShapeKind::Image(area, pixels) => {
            let png = pixels.encode_png().expect("pixels in memory are encoded");
            let data = base64::engine::general_purpose::STANDARD.encode(png);
            format!(
                r#"<image {} preserveAspectRatio="none" image-rendering="optimizeSpeed" href="data:image/png;base64,{data}"/>"#,
                place(area)
            )
        }
        ShapeKind::Text(at, text) => styled(&format!(r#"x="{}" y="{}""#, short(at.x), short(at.y)), text),
        ShapeKind::TextUpwards(at, text) => {
            let place = format!(r#"transform="translate({} {}) rotate(-90)""#, short(at.x), short(at.y));
            styled(&place, text)
        }
    }
}

fn styled(place: &str, text: &Text) -> String {
    let anchor = match text.anchor {
        Anchor::Start => "",
        Anchor::Middle => r#" text-anchor="middle""#,
        Anchor::End => r#" text-anchor="end""#,
    };
    let weight = if text.bold { r#" font-weight="bold""# } else { "" };
    let (size, colour, content) = (short(text.size), text.colour, marked(text));
    format!(r#"<text {place} font-size="{size}" fill="{colour}"{anchor}{weight}>{content}</text>"#)
}

fn place(area: &PlotArea) -> String {
    let [x, y, w, h] = [area.left, area.top, area.width, area.height].map(short);
    format!(r#"x="{x}" y="{y}" width="{w}" height="{h}""#)
}

/// Content of a text element: indices and exponents become shifted spans.
fn marked(text: &Text) -> String {
    let mut content = String::new();
    let mut shift = 0.0;
    for (level, part) in spans(&text.content) {
        let (size, drop) = level.size_and_drop();
        let (part, wanted) = (escaped(part), drop * text.size);
        if level == Level::Base && shift == 0.0 {
            content.push_str(&part);
        } else {
            let size = if level == Level::Base {
                String::new()
            } else {
                format!(r#" font-size="{}""#, short(size * text.size))
            };
            let _ = write!(content, r#"<tspan dy="{}"{size}>{part}</tspan>"#, short(wanted - shift));
        }
        shift = wanted;
    }
    content
}

fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars().map(drawn) {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            c => safe.push(c),
        }
    }
    safe
}

fn pen(stroke: Stroke) -> String {
    let style = match stroke.style {
        Style::Solid => String::new(),
        Style::Dashed(dashes) => {
            let lengths: Vec<_> = dashes.iter().map(u8::to_string).collect();
            format!(r#" stroke-dasharray="{}""#, lengths.join(" "))
        }
        Style::Dots => r#" stroke-linecap="round""#.to_owned(),
    };
    format!(
        r#"stroke="{}" stroke-width="{}" stroke-linejoin="round"{style}"#,
        stroke.colour,
        short(stroke.width)
    )
}

fn path(points: &[CanvasPoint]) -> String {
    let commands = std::iter::once('M').chain(std::iter::repeat('L'));
    commands.zip(points).map(|(command, at)| format!("{command}{} {}", short(at.x), short(at.y))).collect()
}

fn dots(points: &[CanvasPoint]) -> String {
    points.iter().map(|point| format!("M{} {}h{DOT}", short(point.x), short(point.y))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::canvas::Canvas;
    use crate::drawing::shape::at;

    /// Lengths in SVG have at most two decimals.
    #[test]
    fn lengths_have_few_digits() {
        assert_eq!([0.0, -0.001, 1.5, 12.345_67, 100.0].map(short), ["0", "0", "1.5", "12.35", "100"]);
    }

    #[test]
    fn any_text_is_safe_in_xml() {
        let mut canvas = Canvas::new(10.0, 10.0);
        canvas.text(at(0.0, 8.0), &Text::new("a<b & \"c\"\u{0}σ_t>", 9.0));
        let svg = canvas.finish().svg();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let text = document.descendants().find(|node| node.has_tag_name("text")).unwrap();
        let parts: String =
            text.descendants().filter(roxmltree::Node::is_text).filter_map(|n| n.text()).collect();
        assert_eq!(parts, "a<b & \"c\" σt>");
    }
}
