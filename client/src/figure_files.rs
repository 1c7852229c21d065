//! Writes figures to files: the extension of a path selects SVG, PNG or PDF, and several figures get distinct names.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use farm_figures::{Picture, fit_figure, map_figure, spectra_figure};
use farm_lab::document::Block;
use farm_lab::whole_file::write_whole;
use optics_model::fit::{DistanceMap, MaterialFit};

#[derive(Clone, Copy, Debug)]
enum FileFormat {
    Svg,
    Png,
    Pdf,
}

/// The size of figures.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FigureSize {
    /// None: 96 pixels per inch.
    pub(crate) width_mm: Option<f64>,
    /// Pixels per inch of PNG.
    pub(crate) dpi: f64,
}

impl Default for FigureSize {
    /// Two pixels of PNG for each pixel of the page, so that text is sharp.
    fn default() -> Self {
        Self { width_mm: None, dpi: 192.0 }
    }
}

/// Checks that a figure can be written to a path, before any long work.
pub(crate) fn check_path(path: &Path) -> Result<()> {
    format_of(path)?;
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    if parent.is_some_and(|parent| !parent.is_dir()) {
        bail!("figure {}: no such directory", path.display());
    }
    Ok(())
}

/// Writes SVG, PNG or PDF, by the extension. The file is written atomically.
pub(crate) fn write(picture: &Picture, path: &Path, size: FigureSize) -> Result<()> {
    write_whole(path, &content(picture, path, size)?).with_context(|| format!("figure {}", path.display()))
}

/// The bytes of a file of SVG, PNG or PDF, by the extension of its path.
pub(crate) fn content(picture: &Picture, path: &Path, size: FigureSize) -> Result<Vec<u8>> {
    let place = || format!("figure {}", path.display());
    Ok(match format_of(path)? {
        FileFormat::Svg => match size.width_mm {
            Some(width_mm) => picture.svg_of_width(width_mm),
            None => picture.svg(),
        }
        .into_bytes(),
        FileFormat::Png => picture.png(size.width_mm, size.dpi).with_context(place)?,
        FileFormat::Pdf => picture.pdf(size.width_mm).with_context(place)?,
    })
}

fn format_of(path: &Path) -> Result<FileFormat> {
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("svg") => Ok(FileFormat::Svg),
        Some("png") => Ok(FileFormat::Png),
        Some("pdf") => Ok(FileFormat::Pdf),
        _ => bail!("figure {}: unknown kind of file, use .svg, .png or .pdf", path.display()),
    }
}

/// One picture per material: `FILE.svg`, or `FILE-MATERIAL.svg` if there are several, and `FILE-spectra.svg` where channels
/// are wavelengths. Returns the files.
pub(crate) fn write_fits(fits: &[MaterialFit], path: &Path, size: FigureSize) -> Result<Vec<PathBuf>> {
    let of_fits = fits.iter().map(|fit| Ok((fit.material.clone(), fit_figure(fit)?)));
    let spectra = spectra_figure(fits).map(|figure| Ok(("spectra".to_owned(), figure)));
    let figures = of_fits.chain(spectra).collect::<Result<Vec<_>>>()?;
    write_all(&figures, path, size)
}

/// The figures with their names: `FILE.svg`, or `FILE-NAME.svg` if there are several. Returns the files.
pub(crate) fn write_all(
    figures: &[(String, Picture)],
    path: &Path,
    size: FigureSize,
) -> Result<Vec<PathBuf>> {
    let paths = paths(path, figures.iter().map(|(name, _)| name.clone()));
    for ((_, figure), path) in figures.iter().zip(&paths) {
        write(figure, path, size)?;
    }
    Ok(paths)
}

/// One picture per map and material: `FILE.svg`, or `FILE-MATERIAL-CHANNEL.svg` if there are several. Returns the files.
pub(crate) fn write_maps(
    maps: &[(&str, &DistanceMap)],
    path: &Path,
    size: FigureSize,
) -> Result<Vec<PathBuf>> {
    let figure = |(material, map): &(&str, &DistanceMap)| {
        Ok((format!("{material}-{}", map.channel), map_figure(material, map)?))
    };
    write_all(&maps.iter().map(figure).collect::<Result<Vec<_>>>()?, path, size)
}

/// A line for each picture.
pub(crate) fn drawn<P: AsRef<Path>>(pictures: impl IntoIterator<Item = P>) -> Vec<Block> {
    let line = |path: P| Block::Preformatted(format!("drawn: {}", path.as_ref().display()));
    pictures.into_iter().map(line).collect()
}

/// The path itself for one picture; otherwise a path for each name, all distinct even without regard to case.
fn paths(path: &Path, names: impl ExactSizeIterator<Item = String>) -> Vec<PathBuf> {
    if names.len() == 1 {
        return vec![path.to_owned()];
    }
    let mut taken = HashSet::new();
    let distinct = |name: String| {
        let with = |n: usize| if n == 1 { name.clone() } else { format!("{name}_{n}") };
        let free = (1..).map(|n| named(path, &with(n)));
        let mut free = free.filter(|path| taken.insert(path.to_string_lossy().to_lowercase()));
        free.next().expect("numbers do not end")
    };
    names.map(distinct).collect()
}

/// `dir/name-SUFFIX.ext`, with unsuitable characters of the suffix replaced.
fn named(path: &Path, suffix: &str) -> PathBuf {
    let safe = file_name(suffix);
    let (stem, extension) = (path.file_stem().unwrap_or_default(), path.extension().unwrap_or_default());
    path.with_file_name(format!("{}-{safe}.{}", stem.to_string_lossy(), extension.to_string_lossy()))
}

/// Text with all characters replaced that are unsuitable for file names.
pub(crate) fn file_name(text: &str) -> String {
    text.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_pictures_get_names_of_their_own() {
        assert_eq!(named(Path::new("a/fit.svg"), "Vero White/1"), Path::new("a/fit-Vero_White_1.svg"));
        let names = ["white/1", "white 1", "White 1"].map(str::to_owned);
        let paths = paths(Path::new("fit.svg"), names.into_iter());
        assert_eq!(paths, ["fit-white_1.svg", "fit-white_1_2.svg", "fit-White_1_3.svg"].map(PathBuf::from));
    }

    fn picture() -> Picture {
        farm_figures::edge_figure(&[])
    }

    /// The extension decides the format in upper and lower case, and others are refused; so is a folder that does not exist.
    #[test]
    fn file_extension_decides_the_format() {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        for (name, begin) in [("a.SVG", &b"<svg"[..]), ("a.Png", b"\x89PNG")] {
            write(&picture(), &path(name), FigureSize::default()).unwrap();
            assert!(std::fs::read(path(name)).unwrap().starts_with(begin), "{name}");
        }
        for name in ["a.eps", "a", ".svg"] {
            let written = write(&picture(), &path(name), FigureSize::default());
            for error in [check_path(&path(name)), written].map(Result::unwrap_err) {
                let message = format!("{error:#}");
                assert!(message.contains(name) && message.contains("use .svg, .png or .pdf"), "{message}");
            }
        }
        let error = check_path(&path("not-there/a.svg")).unwrap_err();
        assert!(error.to_string().contains("no such directory"));
        check_path(&path("a.svg")).unwrap();
        check_path(Path::new("a.png")).unwrap();
    }
}
