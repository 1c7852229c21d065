//! Grid and scene files from disk.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use farm_proto::{Grid, GridFile, Scene, SceneFile, SceneRef};

/// Largest grid or scene file that is read, in bytes.
const LARGEST: u64 = 16 << 20;

/// The grid that a TOML file describes. Scene files it names are looked for beside it.
pub fn read_grid(path: &Path) -> Result<Grid> {
    let file: GridFile = read_toml(path, "grid file")?;
    let scene = match &file.scene {
        SceneRef::Named(name) => named_scene(name, path.parent().unwrap_or(Path::new(".")))
            .with_context(|| format!("grid file {}", path.display()))?,
        SceneRef::Inline(scene) => to_scene(scene.clone(), path)?,
    };
    file.into_grid(scene).with_context(|| format!("grid file {}", path.display()))
}

/// The scene of a name, `paper` or `smooth`, or of a TOML file.
pub fn read_scene(name: &str) -> Result<Scene> {
    named_scene(name, Path::new("."))
}

fn named_scene(name: &str, folder: &Path) -> Result<Scene> {
    match name {
        "paper" => Ok(Scene::paper()),
        "smooth" => Ok(Scene::smooth()),
        file => {
            let path: PathBuf = folder.join(file);
            if !path.exists() {
                bail!(
                    "scene {name:?} is neither \"paper\" nor \"smooth\" nor a file ({} does not exist)",
                    path.display()
                );
            }
            to_scene(read_toml(&path, "scene file")?, &path)
        }
    }
}

fn to_scene(file: SceneFile, path: &Path) -> Result<Scene> {
    Scene::try_from(file).with_context(|| format!("scene in {}", path.display()))
}

fn read_toml<T: serde::de::DeserializeOwned>(path: &Path, what: &str) -> Result<T> {
    let place = || format!("{what} {}", path.display());
    let size = std::fs::metadata(path).with_context(place)?.len();
    if size > LARGEST {
        bail!("{} has {size} bytes, {LARGEST} are allowed", place());
    }
    let text = std::fs::read_to_string(path).with_context(place)?;
    toml::from_str(&text).with_context(place)
}
