//! Grid and scene files, in TOML.

use serde::{Deserialize, Serialize};

use crate::grid::{Axes, Effort, Grid, NoiseLevel, Quality, Walks};
use crate::invalid::{Invalid, Result};
use crate::scene::{Channel, Layer, LayerMedium, RingLight, Scene, Sensor};

/// Most walks of a transport point under a quality target, unless the file has another number.
const MAX_WALKS: u64 = 25_000_000;

/// Content of a grid file. Lists that are left out are the paper's.
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
    /// Where to stop in any case; 25 million if left out.
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

/// A value given by a name or by a table. By hand, since serde's untagged enums do not tell which key of a table is
/// wrong.
fn name_or_table<'de, D: serde::Deserializer<'de>, Table: Deserialize<'de>, Told>(
    deserializer: D,
    expected: &'static str,
    named: fn(String) -> Told,
    in_full: fn(Table) -> Told,
) -> Result<Told, D::Error> {
    struct NameOrTable<Table, Told> {
        expected: &'static str,
        named: fn(String) -> Told,
        in_full: fn(Table) -> Told,
    }

    impl<'de, Table: Deserialize<'de>, Told> serde::de::Visitor<'de> for NameOrTable<Table, Told> {
        type Value = Told;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str(self.expected)
        }

        fn visit_str<E>(self, name: &str) -> Result<Told, E> {
            Ok((self.named)(name.to_owned()))
        }

        fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<Told, A::Error> {
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

/// Content of a scene file. Tables that are left out are those of the paper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    #[serde(default)]
    pub multiple_scattering: bool,
    pub light: Option<LightTable>,
    pub sensor: Option<SensorTable>,
    #[serde(rename = "channel", default)]
    pub channels: Vec<ChannelTable>,
    #[serde(rename = "layer")]
    pub layers: Vec<LayerTable>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightTable {
    pub ring_deg: [f64; 2],
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorTable {
    pub width_mm: f64,
    pub pixels: u32,
    #[serde(default)]
    pub polar_deg: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelTable {
    pub name: String,
    pub rho_light: f64,
    pub rho_dark: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LayerTable {
    pub name: String,
    /// The sample takes index and thickness from the grid.
    #[serde(default)]
    pub sample: bool,
    pub ior: Option<f64>,
    pub thickness_mm: Option<f64>,
    /// GGX α of the upper face.
    #[serde(default)]
    pub roughness: f64,
}

impl TryFrom<SceneFile> for Scene {
    type Error = Invalid;

    fn try_from(file: SceneFile) -> Result<Self> {
        let paper = Scene::paper();
        let light = match file.light {
            Some(t) => ring_light(t.ring_deg)?,
            None => paper.light(),
        };
        let sensor = match file.sensor {
            Some(t) => Sensor::new(t.width_mm, t.pixels, t.polar_deg).map_err(|e| e.within("sensor"))?,
            None => paper.sensor(),
        };
        let channels = if file.channels.is_empty() {
            paper.channels().to_vec()
        } else {
            crate::invalid::each("channel", file.channels, |c| Channel::new(c.name, c.rho_light, c.rho_dark))?
        };
        let layers = crate::invalid::each("layer", file.layers, layer)?;
        let scene = Scene::new(layers, channels, light, sensor, file.multiple_scattering);
        // In a file it is `[[layer]]` and `[[channel]]`.
        scene.map_err(|e| {
            let field = e.field().replacen("layers", "layer", 1).replacen("channels", "channel", 1);
            e.renamed(field)
        })
    }
}

/// A file has one key for both angles.
fn ring_light([inner, outer]: [f64; 2]) -> Result<RingLight> {
    RingLight::new(inner, outer).map_err(|_| {
        let angles = format!("[{inner}, {outer}]");
        Invalid::new(
            "light.ring_deg",
            angles,
            "two angles from 0 to 90 degrees are needed, the second at least 0.01 above the first",
        )
    })
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

/// The whole number that a float is; None if it is none, or so large that floats have gaps.
pub fn whole(number: f64) -> Option<u64> {
    const EXACT: f64 = (1_u64 << 53) as f64;
    ((0.0..=EXACT).contains(&number) && number.fract() == 0.0).then_some(number as u64)
}

fn layer(table: LayerTable) -> Result<Layer> {
    let LayerTable { name, sample, ior, thickness_mm, roughness } = table;
    match (sample, ior, thickness_mm) {
        (true, None, None) => Layer::sample(name, roughness),
        (true, ..) => Err(Invalid::new(
            "sample",
            "true with ior or thickness_mm",
            "those of the sample come from the grid",
        )),
        (false, Some(ior), Some(thickness)) => Layer::clear(name, ior, thickness, roughness),
        (false, None, _) => Err(Invalid::new("ior", "missing", "a layer that is not the sample needs one")),
        (false, _, None) => {
            Err(Invalid::new("thickness_mm", "missing", "a layer that is not the sample needs one"))
        }
    }
}

impl From<&Scene> for SceneFile {
    fn from(scene: &Scene) -> Self {
        let layers = scene.layers().iter().map(|l| {
            let (ior, thickness_mm) = match l.medium() {
                LayerMedium::Clear { ior, thickness_mm } => (Some(ior), Some(thickness_mm)),
                LayerMedium::Sample => (None, None),
            };
            let (name, roughness) = (l.name().to_owned(), l.roughness());
            LayerTable { name, sample: ior.is_none(), ior, thickness_mm, roughness }
        });
        let channels = scene.channels().iter().map(|c| ChannelTable {
            name: c.name().to_owned(),
            rho_light: c.rho_light(),
            rho_dark: c.rho_dark(),
        });
        let sensor = scene.sensor();
        Self {
            multiple_scattering: scene.multiple_scattering(),
            light: Some(LightTable { ring_deg: [scene.light().inner_deg(), scene.light().outer_deg()] }),
            sensor: Some(SensorTable {
                width_mm: sensor.width_mm(),
                pixels: sensor.pixels() as u32,
                polar_deg: sensor.polar_deg(),
            }),
            channels: channels.collect(),
            layers: layers.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The built-in scenes are unchanged after conversion to TOML and back.
    #[test]
    fn built_in_scenes_survive_toml() {
        for scene in [Scene::paper(), Scene::smooth().with_multiple_scattering(true)] {
            let text = toml::to_string(&SceneFile::from(&scene)).unwrap();
            let back: SceneFile = toml::from_str(&text).unwrap();
            assert_eq!(Scene::try_from(back).unwrap(), scene);
        }
    }

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
        let refused = |text: &str| {
            let file: SceneFile = toml::from_str(text).unwrap();
            Scene::try_from(file).unwrap_err().to_string()
        };
        let error = refused(&format!("[light]\nring_deg = [50, 40]\n{layer}"));
        assert!(error.starts_with("light.ring_deg = [50, 40] is not valid: two angles"), "{error}");
        let channel = "[[channel]]\nname = 'R'\nrho_light = 1\nrho_dark = 0\n";
        let error = refused(&format!("{channel}{channel}{layer}"));
        assert!(error.starts_with("channel[1].name = R is not valid"), "{error}");
        let error = refused(&format!("{layer}{layer}"));
        assert!(error.starts_with("layer = 2 sample layers is not valid"), "{error}");
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

    /// A sample layer with a refractive index of its own is refused.
    #[test]
    fn sample_with_its_own_index_is_refused() {
        let text = "[[layer]]\nname = 's'\nsample = true\nior = 1.5";
        let file: SceneFile = toml::from_str(text).unwrap();
        let error = Scene::try_from(file).unwrap_err();
        assert_eq!(error.field(), "layer[0].sample");
    }
}
