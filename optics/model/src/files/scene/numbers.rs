//! Resolves the numbers of layers in scene files (exact, with a standard error, or those of another layer), and derives
//! their priors.

use serde::{Deserialize, Serialize};

use super::LayerTable;
use crate::invalid::{Invalid, Result};
use crate::scene::{Dispersion, DispersionCurve, Prior, PriorKind, Scene, Scope};

/// A number of a layer.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum LayerNumber {
    Exact(f64),
    Uncertain(UncertainNumber),
    /// The number of another layer, given by the layer's name.
    SameAs(String),
}

/// A number with its standard error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UncertainNumber {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    pub std_error: f64,
    /// "session", "slab", "material" or "channel": the scope within which the number has one value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub per: Option<String>,
    /// How an index depends on the wavelength; its value is that at 589.3 nm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dispersion: Option<DispersionCurve>,
}

impl Default for LayerNumber {
    fn default() -> Self {
        Self::Exact(0.0)
    }
}

impl<'de> Deserialize<'de> for LayerNumber {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct AnyNumber;

        impl<'de> serde::de::Visitor<'de> for AnyNumber {
            type Value = LayerNumber;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(
                    "a number, a table { value, std_error }, or the name of a layer with the same number",
                )
            }

            fn visit_f64<E>(self, number: f64) -> Result<LayerNumber, E> {
                Ok(LayerNumber::Exact(number))
            }

            fn visit_i64<E>(self, number: i64) -> Result<LayerNumber, E> {
                Ok(LayerNumber::Exact(number as f64))
            }

            // JSON has integers without a sign, TOML has none.
            fn visit_u64<E>(self, number: u64) -> Result<LayerNumber, E> {
                Ok(LayerNumber::Exact(number as f64))
            }

            fn visit_str<E>(self, name: &str) -> Result<LayerNumber, E> {
                Ok(LayerNumber::SameAs(name.to_owned()))
            }

            fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<LayerNumber, A::Error> {
                let table = serde::de::value::MapAccessDeserializer::new(map);
                UncertainNumber::deserialize(table).map(LayerNumber::Uncertain)
            }
        }

        deserializer.deserialize_any(AnyNumber)
    }
}

impl LayerNumber {
    pub(super) fn value(&self) -> Option<f64> {
        match self {
            Self::Exact(value) => Some(*value),
            Self::Uncertain(number) => number.value,
            Self::SameAs(_) => None,
        }
    }
}

/// Replaces references to other layers by the numbers of those layers: both are then uncertain together.
pub(super) fn resolved(tables: Vec<LayerTable>) -> Result<Vec<LayerTable>> {
    let all = tables.clone();
    crate::invalid::each("layer", tables, |mut table| {
        let LayerNumber::SameAs(name) = &table.roughness else { return Ok(table) };
        let other = all.iter().find(|t| t.name == *name).map(|t| &t.roughness);
        match other {
            Some(number) if !matches!(number, LayerNumber::SameAs(_)) => table.roughness = number.clone(),
            _ => {
                let names: Vec<&str> = all.iter().map(|t| t.name.as_str()).collect();
                let allowed = format!("a number, or the name of a layer that has one: {}", names.join(", "));
                return Err(Invalid::new("roughness", name, allowed));
            }
        }
        Ok(table)
    })
}

/// Quantities with a standard error, each with the key of the standard error in the file. Layers share a quantity if they
/// have the same name, or if one refers to the other.
pub(super) fn priors(
    scene: &Scene,
    tables: &[LayerTable],
    others: &[(PriorKind, Option<f64>)],
) -> Result<Vec<(String, Prior)>> {
    let mut found: Vec<(PriorKind, &UncertainNumber, Vec<usize>)> = Vec::new();
    for kind in PriorKind::OF_LAYERS {
        for (i, table) in tables.iter().enumerate() {
            let Some(LayerNumber::Uncertain(number)) = table.number(kind) else { continue };
            // The lower face of the sample belongs to the layer below it.
            let shares = |layer: &usize| tables[*layer].name == table.name || tables[*layer].sample;
            let group = found
                .iter_mut()
                .find(|(k, n, layers)| *k == kind && *n == number && layers.iter().any(shares));
            match group {
                Some((.., layers)) => layers.push(i),
                None => found.push((kind, number, vec![i])),
            }
        }
    }
    let mut priors = Vec::new();
    for (kind, number, layers) in found {
        let place = format!("layer[{}].{}", layers[0], kind.key());
        let scope = match &number.per {
            None => default_scope(scene, kind, &layers),
            Some(name) => Scope::ALL.into_iter().find(|s| s.name() == name).ok_or_else(|| {
                Invalid::new(format!("{place}.per"), name, "allowed are session, slab, material and channel")
            })?,
        };
        let prior = Prior::new(kind, layers, number.std_error, scope);
        let prior = match number.dispersion.clone() {
            None => prior,
            Some(curve) => Dispersion::new(curve).and_then(|dispersion| prior?.with_dispersion(dispersion)),
        };
        let prior = prior.map_err(|e| {
            let is_own = e.field() == "std_error" || e.field() == "dispersion";
            e.within(if is_own { place.clone() } else { format!("{place}.dispersion") })
        })?;
        priors.push((format!("{place}.std_error"), prior));
    }
    for &(kind, std_error) in others {
        if let Some(std_error) = std_error {
            let prior = Prior::new(kind, Vec::new(), std_error, Scope::Session);
            priors.push((kind.key().to_owned(), prior.map_err(|e| e.renamed(kind.key()))?));
        }
    }
    Ok(priors)
}

/// The scope of a prior by default: the material for the sample's roughness, index and phase function; the slab for the
/// thickness of a layer that touches the sample, since it depends on how the slab was mounted; otherwise the session.
pub(super) fn default_scope(scene: &Scene, kind: PriorKind, layers: &[usize]) -> Scope {
    let sample = scene.sample_layer();
    match kind {
        PriorKind::Thickness if layers.iter().any(|l| l.abs_diff(sample) == 1) => Scope::Slab,
        PriorKind::Thickness => Scope::Session,
        _ if layers.contains(&sample) => Scope::Material,
        _ => Scope::Session,
    }
}
