//! Reads grid and scene files.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use optics_model::grid::Responses;
use optics_model::{Grid, GridFile, Invalid, Scene, SceneFile, SceneRef};
use optics_tracer::SeenBase;
use toml::de::DeTable;

use crate::bounded_file;
use crate::file_kind::or_other_kind;
use crate::measurement_file::plain;

/// Largest grid or scene file that is read, in bytes.
const LARGEST: u64 = 16 << 20;

/// The grid that a TOML file describes. Paths of scene files are relative to its folder.
pub fn read_grid(path: &Path) -> Result<Grid> {
    let folder = path.parent().unwrap_or(Path::new("."));
    grid_of(&read_text(path, "grid file")?, path, |name| named_scene(name, folder))
}

/// The grid that a TOML file describes, without responses, which take a moment to plan.
pub fn read_grid_without_responses(path: &Path) -> Result<Grid> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let text = read_text(path, "grid file")?;
    plain_grid(&text, path, |name| named_scene(name, folder))
}

/// The grid that the text of a file describes; `scene` resolves the names of scenes.
pub fn grid_of(text: &str, path: &Path, scene: impl Fn(&str) -> Result<Scene>) -> Result<Grid> {
    with_responses(plain_grid(text, path, scene)?).map_err(|e| in_file(e, text, path, "grid file"))
}

fn plain_grid(text: &str, path: &Path, scene: impl Fn(&str) -> Result<Scene>) -> Result<Grid> {
    let file: GridFile = from_toml(text, path, "grid file")?;
    if DeTable::parse(text).is_ok_and(|table| table.get_ref().is_empty()) {
        bail!(
            "grid file {} sets nothing: name at least one field, such as sigma_t_per_mm, or leave the file out for the \
             paper's grid",
            path.display()
        );
    }
    let scene = match &file.scene {
        SceneRef::Named(name) => scene(name).with_context(|| format!("grid file {}", path.display()))?,
        SceneRef::Inline(scene) => {
            Scene::try_from(scene.clone()).map_err(|e| in_file(e.within("scene"), text, path, "grid file"))?
        }
    };
    file.into_grid(scene).map_err(|e| in_file(e, text, path, "grid file"))
}

/// The grid with responses of its scene's uncertain quantities, if there are any.
pub fn with_responses(grid: Grid) -> Result<Grid, Invalid> {
    let base = SeenBase::of(grid.scene());
    let responses = Responses::of(grid.scene(), grid.axes(), |varied| base.through(varied)).map_err(|e| {
        if !e.field().ends_with("sample_ior") {
            return e;
        }
        let allowed = format!("the response of the sample's index would be traced there: {}", e.allowed());
        Invalid::new("sample_ior", e.given(), allowed)
    });
    match responses? {
        Some(responses) => grid.with_responses(responses),
        None => Ok(grid),
    }
}

/// The scene with a name of [`Scene::NAMES`], or of a TOML file.
pub fn read_scene(name: &str) -> Result<Scene> {
    named_scene(name, Path::new("."))
}

/// The scene with a name that stands in a file of `folder`.
pub fn read_scene_in(name: &str, folder: &Path) -> Result<Scene> {
    named_scene(name, folder)
}

fn named_scene(name: &str, folder: &Path) -> Result<Scene> {
    if let Some(scene) = Scene::named(name) {
        return Ok(scene);
    }
    let path: PathBuf = folder.join(name);
    if !path.exists() {
        let names = Scene::NAMES.map(|name| format!("{name:?}")).join(", ");
        bail!("scene {name:?} is none of {names}, and no file ({} does not exist)", path.display());
    }
    let text = read_text(&path, "scene file")?;
    let scene: SceneFile = from_toml(&text, &path, "scene file")?;
    Scene::try_from(scene).map_err(|e| in_file(e, &text, &path, "scene file"))
}

/// The grid with a name: `paper`, or `lab` with its responses.
pub fn named_grid(name: &str) -> Option<Grid> {
    match name {
        "paper" => Some(Grid::paper()),
        "lab" => Some(with_responses(Grid::lab()).expect("the built-in grids are valid")),
        _ => None,
    }
}

pub fn read_text(path: &Path, what: &str) -> Result<String> {
    let place = || format!("{what} {}", path.display());
    let bytes = bounded_file::read(path, LARGEST).with_context(place)?;
    or_other_kind(plain(&bytes), &bytes, what).with_context(place)
}

pub fn from_toml<T: serde::de::DeserializeOwned>(text: &str, path: &Path, what: &str) -> Result<T> {
    toml::from_str(text).or_else(|error| {
        let hint = error.span().and_then(|span| decimal_comma(text, span.start));
        let hint = hint.map_or_else(String::new, |hint| format!(", {hint}"));
        let read = or_other_kind(Err(error.into()), text.as_bytes(), what);
        read.with_context(|| format!("{what} {}{hint}", path.display()))
    })
}

/// A hint about a number with a decimal comma in the line of an offset, if there is one.
fn decimal_comma(text: &str, at: usize) -> Option<String> {
    let before = text.get(..at)?;
    let line = before.matches('\n').count();
    let words = text.lines().nth(line)?.split(|c: char| !(c.is_ascii_digit() || ".,".contains(c)));
    let words = words.map(|word| word.trim_matches(','));
    let is_number = |word: &&str| {
        let parts = word.split_once(',');
        parts.is_some_and(|(a, b)| {
            [a, b].iter().all(|p| !p.is_empty() && p.bytes().all(|c| c.is_ascii_digit()))
        })
    };
    let number = words.into_iter().find(is_number)?;
    let point = number.replace(',', ".");
    Some(format!("line {}: {number} seems to have a decimal comma; write {point}", line + 1))
}

/// Adds the file and line of an invalid value.
pub fn in_file(invalid: Invalid, text: &str, path: &Path, what: &str) -> anyhow::Error {
    let line = line_of(text, invalid.field()).map_or_else(String::new, |line| format!(", line {line}"));
    anyhow::Error::new(invalid).context(format!("{what} {}{line}", path.display()))
}

/// The line of a field such as `layer[2].ior`, or of the innermost existing part of its path; `None` if no part exists.
fn line_of(text: &str, field: &str) -> Option<usize> {
    let table = DeTable::parse(text).ok()?;
    let mut parts = field.split(['.', '[']).map(|part| part.trim_end_matches(']'));
    let mut value = table.get_ref().get(parts.next()?)?;
    for part in parts {
        let inner = match part.parse::<usize>() {
            Ok(index) => value.get_ref().get(index),
            Err(_) => value.get_ref().get(part),
        };
        let Some(inner) = inner else { break };
        value = inner;
    }
    Some(text.get(..value.span().start)?.matches('\n').count() + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An empty grid file is refused: it would be computed as the paper's grid under another name.
    #[test]
    fn empty_grid_file_is_refused() {
        for text in ["", "\n", "# sigma_t_per_mm = [1]\n"] {
            let refused = grid_of(text, Path::new("g.toml"), |_| Ok(Scene::paper())).unwrap_err();
            assert!(refused.to_string().starts_with("grid file g.toml sets nothing"), "{refused}");
        }
        assert!(grid_of("walks = 1000\n", Path::new("g.toml"), |_| Ok(Scene::paper())).is_ok());
    }

    /// A decimal comma is named with its line.
    #[test]
    fn decimal_comma_is_named_with_its_line() {
        let refused = |text: &str| {
            from_toml::<GridFile>(text, Path::new("g.toml"), "grid file").unwrap_err().to_string()
        };
        let message = "grid file g.toml, line 2: 0,5 seems to have a decimal comma; write 0.5";
        assert_eq!(refused("walks = 1\nquality = 0,5\n"), message);
        assert_eq!(refused("walks = 1\nalbedo = [0,5, 0,05]\n"), message);
        assert_eq!(refused("walks = [0.5,1\n"), "grid file g.toml");
    }

    /// The line of a field in a TOML file is found.
    #[test]
    fn fields_are_found_in_their_lines() {
        let text = "# a grid\nalbedo = [\n  0.5,\n  1.5,\n]\nwalks = 1\n[scene.light]\nring_deg = [1, 0]\n\
                    [[scene.layer]]\nname = 'a'\n[[scene.layer]]\nname = 'b'\n";
        for (field, line) in [
            ("albedo[1]", Some(4)),
            ("albedo", Some(2)),
            ("walks", Some(6)),
            ("scene.light.ring_deg", Some(8)),
            ("scene.layer[1].name", Some(12)),
            ("scene.layer[1].ior", Some(11)),
            ("sigma_t_per_mm[0]", None),
        ] {
            assert_eq!(line_of(text, field), line, "{field}");
        }
    }
}
