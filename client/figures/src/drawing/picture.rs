//! A finished figure, as SVG, PNG and PDF.

use std::sync::{Arc, LazyLock};

use anyhow::Context as _;
use krilla::Document;
use krilla::geom::Size;
use krilla::page::PageSettings;
use krilla_svg::{SurfaceExt as _, SvgSettings};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{self, fontdb};

use super::number::short;

/// CSS pixels per inch.
const CSS_DPI: f64 = 96.0;
const MM_PER_INCH: f64 = 25.4;
const POINTS_PER_INCH: f64 = 72.0;

/// A finished figure.
#[derive(Clone, Debug)]
pub struct Picture {
    svg: String,
    width: f64,
    height: f64,
}

impl Picture {
    /// A drawing of a size in CSS pixels.
    pub fn new(svg: String, width: f64, height: f64) -> Self {
        Self { svg, width, height }
    }

    /// The SVG, ready to be embedded in a page.
    pub fn svg(&self) -> &str {
        &self.svg
    }

    /// The SVG with a width in mm.
    pub fn svg_of_width(&self, width_mm: f64) -> String {
        let attributes = |w: &str, h: &str| format!("width=\"{w}\" height=\"{h}\" viewBox");
        let own = attributes(&short(self.width), &short(self.height));
        let [width, height] =
            [width_mm, width_mm * self.height / self.width].map(|l| format!("{}mm", short(l)));
        self.svg.replacen(&own, &attributes(&width, &height), 1)
    }

    fn inches(&self, width_mm: Option<f64>) -> [f64; 2] {
        let width = width_mm.map_or(self.width / CSS_DPI, |mm| mm / MM_PER_INCH);
        [width, width * self.height / self.width]
    }

    /// The drawing parsed by usvg, with its text laid out.
    pub(crate) fn tree(&self) -> anyhow::Result<usvg::Tree> {
        static FONTS: LazyLock<Arc<fontdb::Database>> = LazyLock::new(|| {
            let mut fonts = fontdb::Database::new();
            fonts.load_font_data(dejavu::sans::regular().to_vec());
            fonts.load_font_data(dejavu::sans::bold().to_vec());
            fonts.set_sans_serif_family("DejaVu Sans");
            Arc::new(fonts)
        });
        let options = usvg::Options { fontdb: Arc::clone(&FONTS), ..usvg::Options::default() };
        usvg::Tree::from_str(&self.svg, &options).context("drawing")
    }

    /// Pixels of a width in mm, or else of 96 CSS pixels per inch, with `dpi` pixels per inch.
    pub fn png(&self, width_mm: Option<f64>, dpi: f64) -> anyhow::Result<Vec<u8>> {
        let tree = self.tree()?;
        let [width, height] = self.inches(width_mm).map(|inches| (inches * dpi).ceil() as u32);
        let mut pixels = Pixmap::new(width, height)
            .with_context(|| format!("{width} × {height} pixels are too many for PNG: use .svg or .pdf"))?;
        let scale = f64::from(width) / self.width;
        resvg::render(&tree, Transform::from_scale(scale as f32, scale as f32), &mut pixels.as_mut());
        pixels.encode_png().context("encoding PNG")
    }

    /// A page of a width in mm, or else of 96 CSS pixels per inch, with embedded fonts; the bytes are the same each time.
    pub fn pdf(&self, width_mm: Option<f64>) -> anyhow::Result<Vec<u8>> {
        let tree = self.tree()?;
        let [width, height] = self.inches(width_mm).map(|inches| (inches * POINTS_PER_INCH) as f32);
        let place = || format!("a page of {width} × {height} points");
        let settings = PageSettings::from_wh(width, height).with_context(place)?;
        let size = Size::from_wh(width, height).with_context(place)?;
        let mut document = Document::new();
        let mut page = document.start_page_with(settings);
        let mut surface = page.surface();
        surface.draw_svg(&tree, size, SvgSettings::default()).context("drawing PDF")?;
        surface.finish();
        page.finish();
        document.finish().map_err(|error| anyhow::anyhow!("writing PDF: {error:?}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::canvas::{Canvas, at};
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
