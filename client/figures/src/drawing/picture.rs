//! A finished figure, as SVG, PNG and PDF.

mod pdf;
pub(crate) mod png;
mod svg;

use super::number::short;
use super::shape::Shape;

/// CSS pixels per inch.
const CSS_DPI: f64 = 96.0;
const MM_PER_INCH: f64 = 25.4;
const POINTS_PER_INCH: f64 = 72.0;

/// A finished figure: shapes on a white area of a size in CSS pixels.
#[derive(Clone, Debug)]
pub struct Picture {
    pub(crate) shapes: Vec<Shape>,
    pub(crate) width: f64,
    pub(crate) height: f64,
}

impl Picture {
    /// The SVG, ready to be embedded in a page.
    pub fn svg(&self) -> String {
        svg::write(self, &short(self.width), &short(self.height))
    }

    /// The SVG with a width in mm.
    pub fn svg_of_width(&self, width_mm: f64) -> String {
        let [width, height] =
            [width_mm, width_mm * self.height / self.width].map(|l| format!("{}mm", short(l)));
        svg::write(self, &width, &height)
    }

    fn inches(&self, width_mm: Option<f64>) -> [f64; 2] {
        let width = width_mm.map_or(self.width / CSS_DPI, |mm| mm / MM_PER_INCH);
        [width, width * self.height / self.width]
    }

    /// Pixels of a width in mm, or else of 96 CSS pixels per inch, with `dpi` pixels per inch.
    pub fn png(&self, width_mm: Option<f64>, dpi: f64) -> anyhow::Result<Vec<u8>> {
        let [width, height] = self.inches(width_mm).map(|inches| (inches * dpi).ceil() as u32);
        png::write(self, width, height)
    }

    /// A page of a width in mm, or else of 96 CSS pixels per inch, with embedded fonts; the bytes are the same each time.
    pub fn pdf(&self, width_mm: Option<f64>) -> anyhow::Result<Vec<u8>> {
        let [width, height] = self.inches(width_mm).map(|inches| (inches * POINTS_PER_INCH) as f32);
        pdf::write(self, width, height)
    }
}

#[cfg(test)]
mod tests {
    use tiny_skia::Pixmap;

    use super::*;
    use crate::drawing::canvas::Canvas;
    use crate::drawing::shape::at;
    use crate::drawing::text::Text;

    fn picture() -> Picture {
        let mut canvas = Canvas::new(120.0, 40.0);
        canvas.text(at(4.0, 20.0), &Text::new("σ_t [1/mm]", 12.0));
        canvas.finish()
    }

    /// A PNG has the size of the drawing, or a width in mm, and is not empty.
    #[test]
    fn png_has_the_wanted_size() {
        for (width_mm, dpi, size) in [(None, 192.0, (240, 80)), (Some(50.8), 300.0, (600, 200))] {
            let png = Pixmap::decode_png(&picture().png(width_mm, dpi).unwrap()).unwrap();
            assert_eq!((png.width(), png.height()), size);
            assert!(png.pixels().iter().any(|p| p.red() < 100), "no ink");
        }
    }

    #[test]
    fn svg_has_the_wanted_width() {
        let svg = picture().svg_of_width(60.0);
        assert!(svg.contains("width=\"60mm\" height=\"20mm\" viewBox=\"0 0 120 40\""), "{svg}");
    }

    /// A PDF has a page of the drawing's size in points, embedded fonts, and the same bytes each time.
    #[test]
    fn pdf_is_reproducible_with_the_wanted_size() {
        let pdf = picture().pdf(Some(127.0)).unwrap();
        assert_eq!(pdf, picture().pdf(Some(127.0)).unwrap());
        let text = String::from_utf8_lossy(&pdf);
        assert!(text.starts_with("%PDF-") && text.contains("/MediaBox[0 0 360 120]"), "{text}");
        assert!(text.contains("DejaVuSans"), "no font");
    }
}
