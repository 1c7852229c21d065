//! Defines grid files in TOML and converts them to grids; `scene` does the same for scene files.

mod scene;

use serde::{Deserialize, Serialize};

use crate::grid::{Axes, Effort, Grid, NoiseLevel, Quality, Walks};
use crate::invalid::{Invalid, Result};
use crate::scene::Scene;
pub use scene::SceneFile;

/// Most walks of a transport point under a quality target, unless the file has another number.
const MAX_WALKS: u64 = 25_000_000;

/// Content of a grid file. Lists that are left out take the paper's values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridFile {
    #[serde(default)]
    pub scene: SceneRef,
    pub sigma_t_per_mm: Option<Vec<f64>>,
    pub albedo: Option<Vec<f64>>,
    pub g: Option<Vec<f64>>,
    pub thickness_mm: Option<Vec<f64>>,
    pub sample_ior: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "whole_number")]
    pub walks: Option<u64>,
    pub seed: Option<u64>,
    #[serde(default)]
    pub derivatives: bool,
    /// `"draft"`, `"paper"` (the default) or `"fine"`; or a table, with a target.
    pub quality: Option<QualityRef>,
}

/// A level of noise by its name, or a target.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum QualityRef {
    Level(String),
    Target(QualityTable),
}

impl<'de> Deserialize<'de> for QualityRef {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        name_or_table(deserializer, "draft, paper, fine, or a table", Self::Level, Self::Target)
    }
}

/// Trace more walks where the noise is above a target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QualityTable {
    /// Root mean square of a profile's standard errors over its mean, for the noisiest albedo and channel.
    pub relative_std_error: f64,
    /// Upper limit of the walks; 25 million if left out.
    #[serde(default, deserialize_with = "whole_number")]
    pub max_walks: Option<u64>,
}

/// `"paper"`, `"smooth"`, the path of a scene file, or a whole scene in place.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum SceneRef {
    Named(String),
    Inline(SceneFile),
}

impl<'de> Deserialize<'de> for SceneRef {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let expected = "a scene's name, the path of its file, or a table";
        name_or_table(deserializer, expected, Self::Named, Self::Inline)
    }
}

/// A value given by a name or by a table. Implemented by hand, since serde's untagged enums do not report which key of a
/// table is wrong.
fn name_or_table<'de, D: serde::Deserializer<'de>, Table: Deserialize<'de>, Output>(
    deserializer: D,
    expected: &'static str,
    named: fn(String) -> Output,
    in_full: fn(Table) -> Output,
) -> Result<Output, D::Error> {
    struct NameOrTable<Table, Output> {
        expected: &'static str,
        named: fn(String) -> Output,
        in_full: fn(Table) -> Output,
    }

    impl<'de, Table: Deserialize<'de>, Output> serde::de::Visitor<'de> for NameOrTable<Table, Output> {
        type Value = Output;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str(self.expected)
        }

        fn visit_str<E>(self, name: &str) -> Result<Output, E> {
            Ok((self.named)(name.to_owned()))
        }

        fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<Output, A::Error> {
            Table::deserialize(serde::de::value::MapAccessDeserializer::new(map)).map(self.in_full)
        }
    }

    deserializer.deserialize_any(NameOrTable { expected, named, in_full })
}

impl Default for SceneRef {
    fn default() -> Self {
        Self::Named("paper".to_owned())
    }
}

impl GridFile {
    pub fn into_grid(self, scene: Scene) -> Result<Grid> {
        let paper = Grid::paper();
        let or = |given: Option<Vec<f64>>, paper: &[f64]| given.unwrap_or_else(|| paper.to_vec());
        let axes = Axes {
            sigma_t_per_mm: or(self.sigma_t_per_mm, paper.sigma_t_per_mm()),
            albedo: or(self.albedo, paper.albedo()),
            g: or(self.g, paper.g()),
            thickness_mm: or(self.thickness_mm, paper.thickness_mm()),
            sample_ior: or(self.sample_ior, paper.sample_ior()),
        };
        let level = match &self.quality {
            Some(QualityRef::Level(name)) => Some(NoiseLevel::from_name(name)?),
            _ => None,
        };
        let effort = match (self.walks.map(Walks::new).transpose()?, level) {
            (Some(walks), None) => Effort::Walks(walks),
            (None, level) => Effort::Noise(level.unwrap_or(NoiseLevel::Paper)),
            (Some(walks), Some(level)) => {
                let allowed =
                    format!("quality = {:?} says how many already; leave out one of the two", level.name());
                return Err(Invalid::new("walks", walks.get(), allowed));
            }
        };
        let grid = Grid::new(scene, axes, effort, self.seed.unwrap_or(paper.seed()), self.derivatives)?;
        let Some(QualityRef::Target(table)) = self.quality else { return Ok(grid) };
        let [_, first] = grid.least_and_most_walks();
        let max_walks = Walks::new(table.max_walks.unwrap_or(MAX_WALKS.max(first.get())));
        let max_walks = max_walks.map_err(|e| e.renamed("quality.max_walks"))?;
        grid.with_quality(Quality::new(table.relative_std_error, max_walks).map_err(|e| e.within("quality"))?)
    }
}

/// A whole number that may be written as 1_000_000 or 1e6.
fn whole_number<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Option<u64>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Number {
        Whole(u64),
        Float(f64),
        Other(toml::Value),
    }
    let wrong = |given: &dyn std::fmt::Display| {
        serde::de::Error::custom(format!("{given} is not a whole number, as 1000000 or 1e6 is"))
    };
    match Number::deserialize(deserializer)? {
        Number::Whole(number) => Ok(Some(number)),
        Number::Float(number) => whole(number).map(Some).ok_or_else(|| wrong(&number)),
        Number::Other(value) => Err(wrong(&value)),
    }
}

/// The float as a whole number; None if it is not one, or so large that floats have gaps.
pub fn whole(number: f64) -> Option<u64> {
    const EXACT: f64 = (1_u64 << 53) as f64;
    ((0.0..=EXACT).contains(&number) && number.fract() == 0.0).then_some(number as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An empty grid file means the paper's grid.
    #[test]
    fn empty_grid_file_means_the_paper_grid() {
        let file: GridFile = toml::from_str("").unwrap();
        assert_eq!(file.into_grid(Scene::paper()).unwrap(), Grid::paper());
    }

    /// Errors name the fields as they are written in the file.
    #[test]
    fn errors_name_fields_as_in_the_file() {
        let layer = "[[layer]]\nname = 's'\nsample = true\n";
        let channel = "[[channel]]\nname = 'R'\nrho_light = 1\nrho_dark = 0\n";
        for (text, message) in [
            (
                format!("[light]\nring_deg = [50, 40]\n{layer}"),
                "light.ring_deg = [50, 40] is not valid: two angles",
            ),
            (format!("{channel}{channel}{layer}"), "channel[1].name = R is not valid"),
            (format!("{layer}{layer}"), "layer = 2 sample layers is not valid"),
            (format!("{layer}ior = 1.5"), "layer[0].sample = "),
        ] {
            let file: SceneFile = toml::from_str(&text).unwrap();
            let error = Scene::try_from(file).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
        }
    }

    /// The number of walks may be written as 1000000, 1_000_000 or 1e6.
    #[test]
    fn walks_accept_exponents_and_underscores() {
        for text in ["1000000", "1_000_000", "1e6", "1.0e+6"] {
            let file: GridFile = toml::from_str(&format!("walks = {text}")).unwrap();
            assert_eq!(file.walks, Some(1_000_000), "{text}");
        }
        for text in ["1.5", "-1e6", "1e30", "nan", "'many'"] {
            let error = toml::from_str::<GridFile>(&format!("walks = {text}")).unwrap_err().to_string();
            assert!(error.contains("is not a whole number"), "{text}: {error}");
        }
    }

    #[test]
    fn quality_is_a_level_or_a_table() {
        let grid = |text: &str| toml::from_str::<GridFile>(text).unwrap().into_grid(Scene::paper());
        assert_eq!(grid("").unwrap().effort(), Effort::Noise(NoiseLevel::Paper));
        assert_eq!(grid("quality = 'fine'").unwrap().effort(), Effort::Noise(NoiseLevel::Fine));
        assert_eq!(grid("walks = 5000").unwrap().effort(), Effort::Walks(Walks::new(5000).unwrap()));
        let target = grid("[quality]\nrelative_std_error = 0.01").unwrap();
        assert_eq!((target.effort(), target.quality().is_some()), (NoiseLevel::Paper.into(), true));
        for (text, field) in [
            ("quality = 'best'", "quality"),
            ("walks = 5000\nquality = 'draft'", "walks"),
            ("[quality]\nrelative_std_error = 0.01\nmax_walks = 5000", "quality.max_walks"),
        ] {
            assert_eq!(grid(text).unwrap_err().field(), field, "{text}");
        }
        let error = toml::from_str::<GridFile>("quality = 3").unwrap_err().to_string();
        assert!(error.contains("draft, paper, fine, or a table"), "{error}");
    }
}
