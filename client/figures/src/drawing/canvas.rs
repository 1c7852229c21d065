//! Writes a drawing as SVG text, element by element.

use std::fmt::Write as _;

use anyhow::Context as _;
use base64::Engine as _;
use resvg::tiny_skia::Pixmap;

use super::number::short;
use super::picture::Picture;
use super::rgb::Rgb;
use super::text::{Anchor, Level, SCRIPT, Text, spans};

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
    Dashed(&'static str),
    /// A dot at every point and nothing between.
    Dots,
}

impl Stroke {
    pub(crate) const fn solid(colour: Rgb, width: f64) -> Self {
        Self { colour, width, style: Style::Solid }
    }

    pub(crate) const fn dashed(colour: Rgb, width: f64, dashes: &'static str) -> Self {
        Self { colour, width, style: Style::Dashed(dashes) }
    }

    pub(crate) const fn dots(colour: Rgb, width: f64) -> Self {
        Self { colour, width, style: Style::Dots }
    }
}

/// A drawing under construction. Later elements are drawn above earlier ones.
#[derive(Debug)]
pub(crate) struct Canvas {
    width: f64,
    height: f64,
    body: String,
}

impl Canvas {
    pub(crate) fn new(width: f64, height: f64) -> Self {
        Self { width: width.ceil(), height: height.ceil(), body: String::new() }
    }

    pub(crate) fn fill(&mut self, area: PlotArea, colour: Rgb) {
        let (x, y, w, h) = (short(area.left), short(area.top), short(area.width), short(area.height));
        self.element(&format!(r#"<rect x="{x}" y="{y}" width="{w}" height="{h}" fill="{colour}"/>"#));
    }

    pub(crate) fn line(&mut self, from: CanvasPoint, to: CanvasPoint, stroke: Stroke) {
        self.polyline(&[from, to], stroke);
    }

    pub(crate) fn polyline(&mut self, points: &[CanvasPoint], stroke: Stroke) {
        let path = if stroke.style == Style::Dots { dots(points) } else { path(points) };
        self.element(&format!(r#"<path d="{path}" fill="none" {}/>"#, pen(stroke)));
    }

    pub(crate) fn polygon(&mut self, points: &[CanvasPoint], fill: Option<Rgb>, stroke: Stroke) {
        let fill = fill.map_or_else(|| "none".to_owned(), |colour| colour.to_string());
        self.element(&format!(r#"<path d="{}Z" fill="{fill}" {}/>"#, path(points), pen(stroke)));
    }

    pub(crate) fn circle(&mut self, center: CanvasPoint, radius: f64, fill: Option<Rgb>, stroke: Stroke) {
        let fill = fill.map_or_else(|| "none".to_owned(), |colour| colour.to_string());
        let (x, y, r) = (short(center.x), short(center.y), short(radius));
        self.element(&format!(r#"<circle cx="{x}" cy="{y}" r="{r}" fill="{fill}" {}/>"#, pen(stroke)));
    }

    /// Text with its baseline at a point.
    pub(crate) fn text(&mut self, place: CanvasPoint, text: &Text) {
        let place = format!(r#"x="{}" y="{}""#, short(place.x), short(place.y));
        self.styled_text(&place, text);
    }

    /// Text that reads upwards, its baseline through a point.
    pub(crate) fn text_upwards(&mut self, place: CanvasPoint, text: &Text) {
        let place = format!(r#"transform="translate({} {}) rotate(-90)""#, short(place.x), short(place.y));
        self.styled_text(&place, text);
    }

    /// Pixels stretched over an area without smoothing.
    pub(crate) fn image(&mut self, area: PlotArea, pixels: &Pixmap) -> anyhow::Result<()> {
        let png = pixels.encode_png().context("image within the figure")?;
        let data = base64::engine::general_purpose::STANDARD.encode(png);
        let (x, y, w, h) = (short(area.left), short(area.top), short(area.width), short(area.height));
        self.element(&format!(
            r#"<image x="{x}" y="{y}" width="{w}" height="{h}" preserveAspectRatio="none" image-rendering="optimizeSpeed" href="data:image/png;base64,{data}"/>"#
        ));
        Ok(())
    }

    pub(crate) fn finish(self) -> Picture {
        let (w, h) = (short(self.width), short(self.height));
        let svg = format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="{w}" height="{h}" viewBox="0 0 {w} {h}" font-family="'DejaVu Sans', Verdana, sans-serif">
<rect width="{w}" height="{h}" fill="{}"/>
{}</svg>
"#,
            Rgb::WHITE,
            self.body
        );
        Picture::new(svg, self.width, self.height)
    }

    fn styled_text(&mut self, place: &str, text: &Text) {
        let anchor = match text.anchor {
            Anchor::Start => "",
            Anchor::Middle => r#" text-anchor="middle""#,
            Anchor::End => r#" text-anchor="end""#,
        };
        let weight = if text.bold { r#" font-weight="bold""# } else { "" };
        let (size, colour, content) = (short(text.size), text.colour, marked(text));
        self.element(&format!(
            r#"<text {place} font-size="{size}" fill="{colour}"{anchor}{weight}>{content}</text>"#
        ));
    }

    fn element(&mut self, element: &str) {
        self.body.push_str(element);
        self.body.push('\n');
    }
}

/// Content of a text element: indices and exponents become shifted spans.
fn marked(text: &Text) -> String {
    let mut content = String::new();
    let mut shift = 0.0;
    for (level, part) in spans(&text.content) {
        let wanted = match level {
            Level::Base => 0.0,
            Level::Index => 0.18 * text.size,
            Level::Exponent => -0.36 * text.size,
        };
        let part = escaped(part);
        if level == Level::Base && shift == 0.0 {
            content.push_str(&part);
        } else {
            let size = if level == Level::Base {
                String::new()
            } else {
                format!(r#" font-size="{}""#, short(SCRIPT * text.size))
            };
            let _ = write!(content, r#"<tspan dy="{}"{size}>{part}</tspan>"#, short(wanted - shift));
        }
        shift = wanted;
    }
    content
}

/// Text for XML. Characters that XML forbids become spaces.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '\u{fffe}' | '\u{ffff}' => safe.push(' '),
            c if c.is_control() => safe.push(' '),
            c => safe.push(c),
        }
    }
    safe
}

fn pen(stroke: Stroke) -> String {
    let style = match stroke.style {
        Style::Solid => String::new(),
        Style::Dashed(dashes) => format!(r#" stroke-dasharray="{dashes}""#),
        Style::Dots => r#" stroke-linecap="round""#.to_owned(),
    };
    format!(
        r#"stroke="{}" stroke-width="{}" stroke-linejoin="round"{style}"#,
        stroke.colour,
        short(stroke.width)
    )
}

fn path(points: &[CanvasPoint]) -> String {
    let mut path = String::new();
    for (i, point) in points.iter().enumerate() {
        let command = if i == 0 { 'M' } else { 'L' };
        let _ = write!(path, "{command}{} {}", short(point.x), short(point.y));
    }
    path
}

/// Very short dashes, which round caps turn into dots.
fn dots(points: &[CanvasPoint]) -> String {
    points.iter().map(|point| format!("M{} {}h0.01", short(point.x), short(point.y))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lengths in SVG have at most two decimals.
    #[test]
    fn lengths_have_few_digits() {
        assert_eq!([0.0, -0.001, 1.5, 12.345_67, 100.0].map(short), ["0", "0", "1.5", "12.35", "100"]);
    }

    #[test]
    fn any_text_is_safe_in_xml() {
        let mut canvas = Canvas::new(10.0, 10.0);
        canvas.text(at(0.0, 8.0), &Text::new("a<b & \"c\"\u{0}σ_t>", 9.0));
        let picture = canvas.finish();
        let document = roxmltree::Document::parse(picture.svg()).unwrap();
        let text = document.descendants().find(|node| node.has_tag_name("text")).unwrap();
        let parts: String =
            text.descendants().filter(roxmltree::Node::is_text).filter_map(|n| n.text()).collect();
        assert_eq!(parts, "a<b & \"c\" σt>");
    }
}
