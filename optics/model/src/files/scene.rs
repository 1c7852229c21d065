//! Defines scene files in TOML and converts them to scenes and back: a number of the set-up is exact, or a table with its
//! standard error.

mod numbers;

use serde::{Deserialize, Serialize};

use std::sync::Arc;

use crate::invalid::{Invalid, Result};
use crate::phase::{PhaseShape, PhaseTable, SecondLobe};
use crate::scene::{Channel, Layer, LayerMedium, Prior, PriorKind, RingLight, Scene, Sensor};
use numbers::{LayerNumber, UncertainNumber, default_scope, priors, resolved};

/// Content of a scene file. Tables that are left out are those of the paper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    #[serde(default)]
    pub multiple_scattering: bool,
    pub light: Option<LightTable>,
    pub sensor: Option<SensorTable>,
    pub base: Option<BaseTable>,
    #[serde(rename = "channel", default)]
    pub channels: Vec<ChannelTable>,
    #[serde(rename = "layer")]
    pub layers: Vec<LayerTable>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightTable {
    pub ring_deg: [f64; 2],
    /// Standard error of the mean of both angles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub std_error_deg: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorTable {
    pub width_mm: f64,
    pub pixels: u32,
    #[serde(default)]
    pub polar_deg: f64,
    /// Standard error of `polar_deg`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub std_error_deg: Option<f64>,
    /// Standard error of 0 haze, as a radiance factor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub haze_std_error: Option<f64>,
}

/// The base of all channels.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseTable {
    /// Mean distance across the edge between the places at which light enters the base and leaves it.
    #[serde(default)]
    pub spread_mm: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spread_std_error_mm: Option<f64>,
    /// Standard error of `rho_light`, as a share.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rho_light_std_error: Option<f64>,
    /// Standard error of `rho_dark`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rho_dark_std_error: Option<f64>,
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
    /// Refractive index. The sample's is a table without a value: `{ std_error = 0.01 }`.
    pub ior: Option<LayerNumber>,
    pub thickness_mm: Option<LayerNumber>,
    /// GGX α of the upper face, or the name of the layer with the same value: the sample's name, for its lower face.
    #[serde(default)]
    pub roughness: LayerNumber,
    /// Weight b of the second lobe of the sample's phase function; 0 if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second_lobe_weight: Option<LayerNumber>,
    /// Anisotropy g₂ of the second lobe; 0 if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second_lobe_g: Option<LayerNumber>,
    /// The sample's phase function as a table, in place of lobes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phase_function: Option<PhaseTableFile>,
}

/// A phase function by the scattering angle; the values may have any unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseTableFile {
    pub angle_deg: Vec<f64>,
    pub value: Vec<f64>,
}

impl TryFrom<SceneFile> for Scene {
    type Error = Invalid;

    fn try_from(file: SceneFile) -> Result<Self> {
        let paper = Scene::paper();
        let base = file.base.unwrap_or_default();
        let others = [
            (PriorKind::RingAngle, file.light.as_ref().and_then(|t| t.std_error_deg)),
            (PriorKind::SensorAngle, file.sensor.as_ref().and_then(|t| t.std_error_deg)),
            (PriorKind::BaseSpread, base.spread_std_error_mm),
            (PriorKind::LightSide, base.rho_light_std_error),
            (PriorKind::DarkSide, base.rho_dark_std_error),
            (PriorKind::Haze, file.sensor.as_ref().and_then(|t| t.haze_std_error)),
        ];
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
        let tables = resolved(file.layers)?;
        let layers = crate::invalid::each("layer", &tables, layer)?;
        let phases = crate::invalid::each("layer", &tables, phase)?;
        let scene = Scene::new(layers, channels, light, sensor, file.multiple_scattering);
        // The keys in a file are `[[layer]]` and `[[channel]]`.
        let scene = scene.map_err(|e| {
            let field = e.field().replacen("layers", "layer", 1).replacen("channels", "channel", 1);
            e.renamed(field)
        })?;
        let scene = scene.with_phase(phases.into_iter().flatten().next().unwrap_or_default());
        let scene = scene.with_base_spread(base.spread_mm).map_err(|e| e.renamed("base.spread_mm"))?;
        let (keys, priors): (Vec<String>, Vec<Prior>) = priors(&scene, &tables, &others)?.into_iter().unzip();
        scene.with_priors(priors).map_err(|e| {
            // A file has no list of priors: the error names the key of the standard error instead.
            let index = e.field().split(['[', ']']).nth(1).and_then(|i| i.parse::<usize>().ok());
            let key = index.and_then(|i| keys.get(i).cloned());
            let field = key.unwrap_or_else(|| e.field().to_owned());
            e.renamed(field)
        })
    }
}

impl LayerTable {
    fn number(&self, kind: PriorKind) -> Option<&LayerNumber> {
        match kind {
            PriorKind::Roughness => Some(&self.roughness),
            PriorKind::Thickness => self.thickness_mm.as_ref(),
            PriorKind::Index => self.ior.as_ref(),
            PriorKind::SecondLobeWeight => self.second_lobe_weight.as_ref(),
            PriorKind::SecondLobeG => self.second_lobe_g.as_ref(),
            _ => None,
        }
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

fn layer(table: &LayerTable) -> Result<Layer> {
    let needed = |field: &str, number: Option<&LayerNumber>| {
        number.and_then(LayerNumber::value).ok_or_else(|| {
            Invalid::new(
                field,
                "missing",
                "a layer that is not the sample needs one, or a table with its value",
            )
        })
    };
    let LayerTable { name, sample, ior, thickness_mm, roughness, .. } = table;
    let roughness = needed("roughness", Some(roughness))?;
    if !sample {
        let (ior, thickness_mm) =
            (needed("ior", ior.as_ref())?, needed("thickness_mm", thickness_mm.as_ref())?);
        return Layer::clear(name, ior, thickness_mm, roughness);
    }
    if ior.as_ref().and_then(LayerNumber::value).is_some() || thickness_mm.is_some() {
        let allowed =
            "those of the sample come from the grid; `ior = { std_error = … }` makes its index uncertain";
        return Err(Invalid::new("sample", "true with ior or thickness_mm", allowed));
    }
    Layer::sample(name, roughness)
}

/// The shape of the phase function, if a layer has one.
fn phase(table: &LayerTable) -> Result<Option<PhaseShape>> {
    let lobes = [
        ("second_lobe_weight", table.second_lobe_weight.as_ref()),
        ("second_lobe_g", table.second_lobe_g.as_ref()),
    ];
    let first = lobes.iter().find(|(_, number)| number.is_some()).map(|(field, _)| *field);
    let first = first.or(table.phase_function.as_ref().map(|_| "phase_function"));
    let Some(first) = first else { return Ok(None) };
    if !table.sample {
        let given = format!("a number of {}", table.name);
        return Err(Invalid::new(first, given, "the sample alone has a phase function"));
    }
    if let Some(tabulated) = &table.phase_function {
        if first != "phase_function" {
            return Err(Invalid::new(
                first,
                "given with phase_function",
                "a table has no lobes: give one of them",
            ));
        }
        let tabulated = PhaseTable::new(tabulated.angle_deg.clone(), tabulated.value.clone())?;
        return Ok(Some(PhaseShape::Table(Arc::new(tabulated))));
    }
    let value = |(field, number): (&str, Option<&LayerNumber>)| match number {
        None => Ok(0.0),
        Some(number) => number.value().ok_or_else(|| {
            Invalid::new(field, "no number", "a number is needed, or a table with value and std_error")
        }),
    };
    let [weight, g] = lobes;
    Ok(Some(PhaseShape::Lobes(SecondLobe::new(value(weight)?, value(g)?)?)))
}

impl From<&Scene> for SceneFile {
    fn from(scene: &Scene) -> Self {
        let number = |kind: PriorKind, layer: usize| {
            let value = scene.number(kind, Some(layer));
            let prior = scene.priors().iter().find(|p| p.kind() == kind && p.layers().contains(&layer));
            let name = |layer: usize| scene.layers()[layer].name();
            match prior {
                Some(prior) if name(prior.layers()[0]) != name(layer) => {
                    Some(LayerNumber::SameAs(name(prior.layers()[0]).to_owned()))
                }
                Some(prior) => {
                    let per =
                        Some(prior.scope()).filter(|s| *s != default_scope(scene, kind, prior.layers()));
                    let per = per.map(|scope| scope.name().to_owned());
                    let dispersion = prior.dispersion().map(|dispersion| dispersion.curve().clone());
                    let std_error = prior.std_error();
                    Some(LayerNumber::Uncertain(UncertainNumber { value, std_error, per, dispersion }))
                }
                None => value.map(LayerNumber::Exact),
            }
        };
        // Plain Henyey–Greenstein needs no second lobe.
        let lobe_number = |kind: PriorKind, layer: usize| {
            number(kind, layer).filter(|_| *scene.phase() != PhaseShape::default())
        };
        let table =
            |t: &PhaseTable| PhaseTableFile { angle_deg: t.angle_deg().to_vec(), value: t.value().to_vec() };
        let layers = scene.layers().iter().enumerate().map(|(i, l)| LayerTable {
            name: l.name().to_owned(),
            sample: l.medium() == LayerMedium::Sample,
            ior: number(PriorKind::Index, i),
            thickness_mm: number(PriorKind::Thickness, i),
            roughness: number(PriorKind::Roughness, i).unwrap_or_default(),
            second_lobe_weight: lobe_number(PriorKind::SecondLobeWeight, i),
            second_lobe_g: lobe_number(PriorKind::SecondLobeG, i),
            phase_function: scene.phase().table().filter(|_| l.medium() == LayerMedium::Sample).map(table),
        });
        let channels = scene.channels().iter().map(|c| ChannelTable {
            name: c.name().to_owned(),
            rho_light: c.rho_light(),
            rho_dark: c.rho_dark(),
        });
        let error_of = |kind| scene.priors().iter().find(|p| p.kind() == kind).map(Prior::std_error);
        let (light, sensor) = (scene.light(), scene.sensor());
        Self {
            multiple_scattering: scene.multiple_scattering(),
            light: Some(LightTable {
                ring_deg: [light.inner_deg(), light.outer_deg()],
                std_error_deg: error_of(PriorKind::RingAngle),
            }),
            sensor: Some(SensorTable {
                width_mm: sensor.width_mm(),
                pixels: sensor.pixels() as u32,
                polar_deg: sensor.polar_deg(),
                std_error_deg: error_of(PriorKind::SensorAngle),
                haze_std_error: error_of(PriorKind::Haze),
            }),
            base: Some(BaseTable {
                spread_mm: scene.base_spread_mm(),
                spread_std_error_mm: error_of(PriorKind::BaseSpread),
                rho_light_std_error: error_of(PriorKind::LightSide),
                rho_dark_std_error: error_of(PriorKind::DarkSide),
            })
            .filter(|base| *base != BaseTable::default()),
            channels: channels.collect(),
            layers: layers.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scope;

    fn scene(text: &str) -> Result<Scene> {
        Scene::try_from(toml::from_str::<SceneFile>(text).unwrap())
    }

    /// The built-in scenes are unchanged after conversion to TOML and back.
    #[test]
    fn built_in_scenes_survive_toml() {
        for built_in in [Scene::paper(), Scene::smooth().with_multiple_scattering(true), Scene::lab()] {
            let text = toml::to_string(&SceneFile::from(&built_in)).unwrap();
            assert_eq!(scene(&text).unwrap(), built_in, "{text}");
        }
    }

    /// The roughness of the sample's lower face may refer to the sample by name.
    #[test]
    fn roughness_may_be_that_of_another_layer() {
        let text = "[[layer]]\nname = 'resin'\nsample = true\nior = { std_error = 0.02 }\n\
                    roughness = { value = 0.1, std_error = 0.05 }\n\
                    [[layer]]\nname = 'gel'\nior = 1.4\nthickness_mm = { value = 0.1, std_error = 0.02, per = 'session' }\n\
                    roughness = 'resin'\n";
        let scene = scene(text).unwrap();
        assert_eq!(scene.layers()[1].roughness(), 0.1);
        for (prior, (name, layers, scope)) in scene.priors().iter().zip([
            ("resin roughness", &[0, 1][..], Scope::Material),
            ("gel thickness", &[1], Scope::Session),
            ("resin index", &[0], Scope::Material),
        ]) {
            assert_eq!((&*scene.name_of(prior), prior.layers(), prior.scope()), (name, layers, scope));
        }
        assert_eq!(scene.priors().len(), 3);
    }

    /// Refusals name the number as it stands in the file.
    #[test]
    fn wrong_uncertain_numbers_are_refused() {
        let sample = "[[layer]]\nname = 's'\nsample = true\n";
        for (text, expected) in [
            ("roughness = 'gel'", "layer[0].roughness = gel is not valid: a number, or the name"),
            ("roughness = { value = 0.05, std_error = 0 }", "layer[0].roughness.std_error = 0"),
            ("roughness = { std_error = 0.1 }", "layer[0].roughness = missing"),
            (
                "ior = { std_error = 0.1, per = 'day' }",
                "layer[0].ior.per = day is not valid: allowed are session, slab, material and channel",
            ),
            (
                "roughness = { value = 1.2, std_error = 0.1 }",
                "layer[0].roughness = 1.2 is not valid: allowed are 0 (smooth) and 0.001 to 1",
            ),
            (
                "[[layer]]\nname = 'g'\nior = 1.3\nthickness_mm = { value = -0.02, std_error = 0.02 }",
                "layer[1].thickness_mm = -0.02 is not valid: allowed are 0 and 1e-4 to 1000 mm",
            ),
            (
                "[[layer]]\nname = 'g'\nior = { value = 0.9, std_error = 0.01 }\nthickness_mm = 1",
                "layer[1].ior = 0.9 is not valid: allowed are 1 to 4",
            ),
            ("[light]\nring_deg = [85, 95]\nstd_error_deg = 1", "light.ring_deg = [85, 95] is not valid"),
            ("[light]\nring_deg = [40, 50]\nstd_error_deg = -1", "light.std_error_deg = -1"),
            ("[light]\nring_deg = [40, 50]\nstd_error_deg = 60", "light.std_error_deg = 60"),
            (
                "[[layer]]\nname = 'g'\nior = { value = 1.3, std_error = 4 }\nthickness_mm = 1",
                "layer[1].ior.std_error = 4 is not valid: the response of the g index would be traced at ior = -8.7",
            ),
        ] {
            let error = scene(&format!("{sample}{text}")).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        let error = toml::from_str::<SceneFile>(&format!("{sample}roughness = {{ mean = 1 }}")).unwrap_err();
        assert!(error.to_string().contains("unknown field `mean`"), "{error}");
    }
}
