//! A finished figure, as SVG and as PNG.

use std::sync::{Arc, LazyLock};

use anyhow::Context as _;
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{self, fontdb};

/// Pixels of a PNG for one CSS pixel, so that text is sharp.
const PNG_SCALE: f32 = 2.0;

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

    pub fn png(&self) -> anyhow::Result<Vec<u8>> {
        let tree = self.tree()?;
        let [width, height] = [self.width, self.height].map(|l| (l * f64::from(PNG_SCALE)).ceil() as u32);
        let mut pixels = Pixmap::new(width, height)
            .with_context(|| format!("{width} × {height} pixels are too many for PNG: use .svg"))?;
        resvg::render(&tree, Transform::from_scale(PNG_SCALE, PNG_SCALE), &mut pixels.as_mut());
        pixels.encode_png().context("encoding PNG")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::canvas::{Canvas, at};
    use crate::drawing::text::Text;

    /// A PNG has twice the size of the drawing in pixels, and is not empty.
    #[test]
    fn png_has_the_size_of_the_drawing() {
        let mut canvas = Canvas::new(120.0, 40.0);
        canvas.text(at(4.0, 20.0), &Text::new("σ_t [1/mm]", 12.0));
        let png = Pixmap::decode_png(&canvas.finish().png().unwrap()).unwrap();
        assert_eq!((png.width(), png.height()), (240, 80));
        assert!(png.pixels().iter().any(|p| p.red() < 100), "no ink");
    }
}
