//! A finished figure and its files.

use std::path::Path;
use std::sync::{Arc, LazyLock};

use anyhow::{Context as _, bail};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{self, fontdb};

use crate::output::write_whole;

/// Pixels of a PNG for one CSS pixel, so that text is sharp.
const PNG_SCALE: f32 = 2.0;

/// A finished figure.
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    svg: String,
    width: f64,
    height: f64,
}

#[derive(Clone, Copy, Debug)]
enum Format {
    Svg,
    Png,
}

impl Picture {
    pub(super) fn new(svg: String, width: f64, height: f64) -> Self {
        Self { svg, width, height }
    }

    /// Whether a figure can be written to `path`: to be asked before long work.
    pub(crate) fn check_path(path: &Path) -> anyhow::Result<()> {
        format_of(path)?;
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        if parent.is_some_and(|parent| !parent.is_dir()) {
            bail!("figure {}: no such directory", path.display());
        }
        Ok(())
    }

    /// Writes SVG or PNG, by the extension. The file is written beside and renamed, so that it is whole or not there.
    pub(crate) fn write(&self, path: &Path) -> anyhow::Result<()> {
        let bytes = match format_of(path)? {
            Format::Svg => self.svg.clone().into_bytes(),
            Format::Png => self.png().with_context(|| format!("figure {}", path.display()))?,
        };
        write_whole(path, &bytes).with_context(|| format!("figure {}", path.display()))
    }

    /// The drawing as it stands within a page.
    pub(crate) fn svg(&self) -> &str {
        &self.svg
    }

    /// The drawing as resvg understands it, text laid out.
    pub(super) fn tree(&self) -> anyhow::Result<usvg::Tree> {
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

    pub(crate) fn png(&self) -> anyhow::Result<Vec<u8>> {
        let tree = self.tree()?;
        let [width, height] = [self.width, self.height].map(|l| (l * f64::from(PNG_SCALE)).ceil() as u32);
        let mut pixels = Pixmap::new(width, height)
            .with_context(|| format!("{width} × {height} pixels are too many for PNG: use .svg"))?;
        resvg::render(&tree, Transform::from_scale(PNG_SCALE, PNG_SCALE), &mut pixels.as_mut());
        pixels.encode_png().context("encoding PNG")
    }
}

fn format_of(path: &Path) -> anyhow::Result<Format> {
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("svg") => Ok(Format::Svg),
        Some("png") => Ok(Format::Png),
        _ => bail!("figure {}: unknown kind of file, use .svg or .png", path.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::canvas::{Canvas, at};
    use super::super::text::Text;
    use super::*;

    fn picture() -> Picture {
        let mut canvas = Canvas::new(120.0, 40.0);
        canvas.text(at(4.0, 20.0), &Text::new("σ_t [1/mm]", 12.0));
        canvas.finish()
    }

    #[test]
    fn the_extension_decides_in_any_case_and_others_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let (svg, png) = (dir.path().join("a.SVG"), dir.path().join("a.Png"));
        picture().write(&svg).unwrap();
        picture().write(&png).unwrap();
        assert!(std::fs::read_to_string(svg).unwrap().starts_with("<svg"));
        let png = Pixmap::load_png(png).unwrap();
        assert_eq!((png.width(), png.height()), (240, 80));
        assert!(png.pixels().iter().any(|p| p.red() < 100), "no ink");
        for name in ["a.pdf", "a", ".svg"] {
            let path = dir.path().join(name);
            for error in [Picture::check_path(&path), picture().write(&path)].map(Result::unwrap_err) {
                let message = format!("{error:#}");
                assert!(message.contains(name) && message.contains("use .svg or .png"), "{message}");
            }
        }
    }

    #[test]
    fn a_path_without_its_directory_is_refused_early() {
        let dir = tempfile::tempdir().unwrap();
        let error = Picture::check_path(&dir.path().join("not-there/a.svg")).unwrap_err();
        assert!(error.to_string().contains("no such directory"));
        Picture::check_path(&dir.path().join("a.svg")).unwrap();
        Picture::check_path(Path::new("a.png")).unwrap();
    }

    #[test]
    fn nothing_half_written_stays() {
        let dir = tempfile::tempdir().unwrap();
        // A directory in the place of the file makes the renaming fail.
        let taken = dir.path().join("a.svg");
        std::fs::create_dir(&taken).unwrap();
        std::fs::write(taken.join("inside"), "").unwrap();
        picture().write(&taken).unwrap_err();
        picture().write(&dir.path().join("b.png")).unwrap();
        let mut names: Vec<_> =
            std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["a.svg", "b.png"]);
    }
}
