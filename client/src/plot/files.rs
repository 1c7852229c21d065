//! Pictures of answers as files, each with a name of its own.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::Result;
use optics_model::fit::{DistanceMap, MaterialFit};

use super::{fit_figure, map_figure};

/// One picture per material: `FILE.svg`, or `FILE-MATERIAL.svg` if there are several. Returns the files.
pub(crate) fn write_fits(fits: &[MaterialFit], path: &Path) -> Result<Vec<PathBuf>> {
    let paths = paths(path, fits.iter().map(|fit| fit.material.clone()));
    for (fit, path) in fits.iter().zip(&paths) {
        fit_figure(fit)?.write(path)?;
    }
    Ok(paths)
}

/// One picture per map and material: `FILE.svg`, or `FILE-MATERIAL-CHANNEL.svg` if there are several.
pub(crate) fn write_maps(maps: &[(&str, &DistanceMap)], path: &Path) -> Result<()> {
    let paths = paths(path, maps.iter().map(|(material, map)| format!("{material}-{}", map.channel)));
    for ((material, map), path) in maps.iter().zip(paths) {
        map_figure(material, map)?.write(&path)?;
    }
    Ok(())
}

/// A line for each picture that was drawn.
pub(crate) fn drawn<P: AsRef<Path>>(pictures: impl IntoIterator<Item = P>) -> String {
    pictures.into_iter().map(|path| format!("\ndrawn: {}", path.as_ref().display())).collect()
}

/// The path itself for one picture; otherwise a path for each name, all different, also where case does not count.
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
        let names = ["white/1", "white 1", "White 1"].map(str::to_owned);
        let paths = paths(Path::new("fit.svg"), names.into_iter());
        assert_eq!(paths, ["fit-white_1.svg", "fit-white_1_2.svg", "fit-White_1_3.svg"].map(PathBuf::from));
    }
}
