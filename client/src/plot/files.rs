//! Pictures of answers as files, each with a name of its own.

use std::path::{Path, PathBuf};

use anyhow::Result;
use optics_model::fit::{DistanceMap, MaterialFit};

use super::{fit_figure, map_figure};

/// One picture per material: `FILE.svg`, or `FILE-MATERIAL.svg` if there are several. Returns the files.
pub(crate) fn write_fits(fits: &[MaterialFit], path: &Path) -> Result<Vec<PathBuf>> {
    let write = |fit: &MaterialFit| {
        let path = if fits.len() == 1 { path.to_owned() } else { named(path, &fit.material) };
        fit_figure(fit)?.write(&path)?;
        Ok(path)
    };
    fits.iter().map(write).collect()
}

/// One picture per map and material: `FILE.svg`, or `FILE-MATERIAL-CHANNEL.svg` if there are several.
pub(crate) fn write_maps(maps: &[(&str, &DistanceMap)], path: &Path) -> Result<()> {
    for (material, map) in maps {
        let name = format!("{material}-{}", map.channel);
        let path = if maps.len() == 1 { path.to_owned() } else { named(path, &name) };
        map_figure(material, map)?.write(&path)?;
    }
    Ok(())
}

/// A line for each picture that was drawn.
pub(crate) fn drawn<P: AsRef<Path>>(pictures: impl IntoIterator<Item = P>) -> String {
    pictures.into_iter().map(|path| format!("\ndrawn: {}", path.as_ref().display())).collect()
}

/// `dir/name-SUFFIX.ext`, with what does not belong in a file name replaced.
fn named(path: &Path, suffix: &str) -> PathBuf {
    let safe = file_name(suffix);
    let (stem, extension) = (path.file_stem().unwrap_or_default(), path.extension().unwrap_or_default());
    path.with_file_name(format!("{}-{safe}.{}", stem.to_string_lossy(), extension.to_string_lossy()))
}

/// Text with what does not belong in a file name replaced.
pub(crate) fn file_name(text: &str) -> String {
    text.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_pictures_get_names_of_their_own() {
        assert_eq!(named(Path::new("a/fit.svg"), "Vero White/1"), Path::new("a/fit-Vero_White_1.svg"));
    }
}
