//! Lists the quantities in which two scenes differ. Each value is a text with its prior.

use super::{Channel, Layer, Prior, PriorKind, Scene, Scope};
use crate::phase::PhaseTable;

/// A quantity that has another value or another prior in another scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SceneDifference {
    /// Name, such as `gel thickness` or `rho_light of R`.
    pub quantity: String,
    /// Value in this scene with its unit, such as `0.02 ± 0.01 mm per slab`.
    pub own: String,
    /// Value in the other scene.
    pub other: String,
}

impl Scene {
    /// The quantities that have another value or prior in `other`. Numbers of layers and channels are compared where both
    /// scenes have one of this name. Width and pixels of the sensor are not compared: they change no radiance.
    pub fn differences(&self, other: &Self) -> Vec<SceneDifference> {
        let others = other.quantities();
        let differs = |(quantity, own): (String, String)| {
            let (_, other) = others.iter().find(|(name, _)| *name == quantity)?;
            (own != *other).then(|| SceneDifference { quantity, own, other: other.clone() })
        };
        self.quantities().into_iter().filter_map(differs).collect()
    }

    /// Names and values.
    fn quantities(&self) -> Vec<(String, String)> {
        let list = |names: Vec<&str>| names.join(", ");
        let layers = list(self.layers.iter().map(Layer::name).collect());
        let channels = list(self.channels.iter().map(Channel::name).collect());
        let phase = |table: &PhaseTable| format!("tabulated, mean cosine {:.4}", table.mean_cosine());
        let phase = self.phase.table().map_or_else(|| "lobes".to_owned(), phase);
        let kept = if self.multiple_scattering { "kept" } else { "lost" };
        let ring = format!("{}…{}", self.light.inner_deg(), self.light.outer_deg());
        let mut all = vec![
            ("layers".to_owned(), layers),
            ("phase function".to_owned(), phase),
            ("light scattered repeatedly by rough surfaces".to_owned(), kept.to_owned()),
            ("ring".to_owned(), self.with_prior(PriorKind::RingAngle, None, &ring)),
        ];
        for kind in PriorKind::ALL.into_iter().filter(|kind| *kind != PriorKind::RingAngle) {
            if let Some(value) = self.number(kind, None) {
                all.push((kind.name().to_owned(), self.with_prior(kind, None, &value.to_string())));
            }
        }
        all.extend(self.numbers_of_layers());
        all.push(("channels".to_owned(), channels));
        for channel in &self.channels {
            all.push((format!("rho_light of {}", channel.name()), channel.rho_light().to_string()));
            all.push((format!("rho_dark of {}", channel.name()), channel.rho_dark().to_string()));
        }
        all
    }

    /// The values of layers of one name are joined in one text, from top to bottom; a common value occurs once.
    fn numbers_of_layers(&self) -> Vec<(String, String)> {
        let mut all: Vec<(String, Vec<String>)> = Vec::new();
        for (i, layer) in self.layers.iter().enumerate() {
            for kind in PriorKind::OF_LAYERS.into_iter().rev() {
                let number = match self.number(kind, Some(i)) {
                    Some(number) => number.to_string(),
                    None if kind == PriorKind::Index => "the grid's".to_owned(),
                    None => continue,
                };
                let (name, text) =
                    (format!("{} {}", layer.name(), kind.name()), self.with_prior(kind, Some(i), &number));
                match all.iter_mut().find(|(known, _)| *known == name) {
                    Some((_, texts)) => texts.push(text),
                    None => all.push((name, vec![text])),
                }
            }
        }
        let joined = |texts: Vec<String>| {
            if texts.iter().all(|text| *text == texts[0]) { texts[0].clone() } else { texts.join(", ") }
        };
        all.into_iter().map(|(name, texts)| (name, joined(texts))).collect()
    }

    /// A value with its standard error, its unit and the scope of its prior.
    fn with_prior(&self, kind: PriorKind, layer: Option<usize>, value: &str) -> String {
        let is_own = |prior: &&Prior| {
            prior.kind() == kind && layer.is_none_or(|layer| prior.layers().contains(&layer))
        };
        let unit = if kind.unit() == "mm" { " mm" } else { kind.unit() };
        match self.priors.iter().find(is_own) {
            Some(prior) => {
                let per = match prior.scope() {
                    Scope::Session => String::new(),
                    scope => format!(" per {}", scope.name()),
                };
                let curve = prior.dispersion().map_or_else(String::new, |curve| format!(", {curve}"));
                format!("{value} ± {}{unit}{per}{curve}", prior.std_error())
            }
            None => format!("{value}{unit}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{RingLight, Sensor};

    fn texts(own: &Scene, other: &Scene) -> Vec<String> {
        let text = |d: SceneDifference| format!("{}: {} | {}", d.quantity, d.own, d.other);
        own.differences(other).into_iter().map(text).collect()
    }

    /// Every number of a scene is compared, with its prior.
    #[test]
    fn differences_have_both_values() {
        let (lab, paper) = (Scene::lab(), Scene::paper());
        let narrow = |prior: &Prior| {
            let is_gel = lab.name_of(prior) == "gel thickness";
            let std_error = if is_gel { 0.004 } else { prior.std_error() };
            Prior::new(prior.kind(), prior.layers().to_vec(), std_error, prior.scope()).unwrap()
        };
        let narrower = lab.clone().with_priors(lab.priors().iter().map(narrow).collect()).unwrap();
        let tilted = |pixels| Scene::paper().with_sensor(Sensor::new(10.0, pixels, 8.0).unwrap());
        let darker = vec![Channel::new("R", 0.95, 0.024).unwrap()];
        for (own, other, expected) in [
            (&lab, &lab, &[][..]),
            (&narrower, &lab, &["gel thickness: 0.02 ± 0.004 mm per slab | 0.02 ± 0.02 mm per slab"]),
            (
                &Scene::paper().with_light(RingLight::new(40.0, 55.0).unwrap()),
                &paper,
                &["ring: 40…55° | 40…50°"],
            ),
            (&tilted(100), &paper, &["sensor angle: 8° | 0°"]),
            (&tilted(100), &tilted(200), &[]),
            (
                &Scene::paper().with_channels(darker).unwrap(),
                &paper,
                &["channels: R | R, G, B", "rho_light of R: 0.95 | 0.985"],
            ),
            (
                &Scene::paper().with_multiple_scattering(true),
                &paper,
                &["light scattered repeatedly by rough surfaces: kept | lost"],
            ),
        ] {
            assert_eq!(texts(own, other), expected);
        }
    }

    /// Layers of one name share a text, from top to bottom.
    #[test]
    fn layers_of_one_name_are_compared_together() {
        let scene = |lower_mm| {
            let paper = Scene::paper();
            let gel = |thickness| Layer::clear("gel", 1.33, thickness, 0.0).unwrap();
            let layers = vec![gel(0.02), Layer::sample("sample", 0.05).unwrap(), gel(lower_mm)];
            Scene::new(layers, paper.channels().to_vec(), paper.light(), paper.sensor(), false).unwrap()
        };
        assert_eq!(texts(&scene(0.02), &scene(0.03)), ["gel thickness: 0.02 mm | 0.02 mm, 0.03 mm"]);
        let other = texts(&scene(0.02), &Scene::paper());
        assert_eq!(other[0], "layers: gel, sample, gel | glass slip, gel, sample, gel, coat");
        assert_eq!(other[1..], ["gel roughness: 0 | 0, 0.05"]);
    }
}
