//! Reads from a TOML file which materials are mixtures of which inks.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use optics_model::Invalid;
use optics_model::fit::{Mixture, Mixtures};
use optics_model::invalid::each;
use serde::Deserialize;

use crate::grid_file::{from_toml, read_text};
use crate::measurement_file::{normal, plain};

const WHAT: &str = "mixture file";
const MOST_MIXTURES: usize = 2000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    mixture: Vec<MixtureEntry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MixtureEntry {
    material: String,
    /// Volume fractions by ink.
    parts: BTreeMap<String, f64>,
}

/// Reads and checks a file of mixtures.
pub fn read_mixtures(path: &Path) -> Result<Mixtures> {
    mixtures_of(&read_text(path, WHAT)?, path)
}

/// Reads and checks the bytes of a file of mixtures.
pub fn mixtures_in(bytes: &[u8], name: &Path) -> Result<Mixtures> {
    mixtures_of(&plain(bytes).with_context(|| format!("{WHAT} {}", name.display()))?, name)
}

fn mixtures_of(text: &str, path: &Path) -> Result<Mixtures> {
    let file: File = from_toml(text, path, WHAT)?;
    mixtures(file).with_context(|| format!("{WHAT} {}", path.display()))
}

fn mixtures(file: File) -> optics_model::Result<Mixtures> {
    // Names are normalised as in measurements.
    let mixture = |entry: MixtureEntry| {
        let parts = entry.parts.into_iter().map(|(ink, share)| (normal(&ink).into_owned(), share));
        Mixture::new(normal(&entry.material), parts)
    };
    if file.mixture.len() > MOST_MIXTURES {
        let given = format!("{} entries", file.mixture.len());
        return Err(Invalid::new("mixture", given, format!("at most {MOST_MIXTURES} are allowed")));
    }
    Mixtures::new(each("mixture", file.mixture, mixture)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Mixtures, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("chart.toml");
        std::fs::write(&path, text).unwrap();
        read_mixtures(&path).map_err(|e| format!("{e:#}"))
    }

    #[test]
    fn mixtures_are_read_with_their_parts() {
        let text = "[[mixture]]\nmaterial = 'pale'\nparts = { white = 0.75, cyan = 0.25 }\n";
        let found = read(text).unwrap();
        assert_eq!(found.all()[0].material(), "pale");
        assert_eq!(found.parts_of("pale"), Some(vec![("cyan", 0.25), ("white", 0.75)]));
    }

    /// Errors of a mixture file are reported with their place.
    #[test]
    fn mixture_errors_name_their_place() {
        for (text, message) in [
            ("", "mixture = none is not valid: at least one is needed"),
            ("[[mixture]]\nmaterial = 'pale'\n", "missing field `parts`"),
            ("[[mixtures]]\n", "unknown field `mixtures`"),
            (
                "[[mixture]]\nmaterial = 'pale'\nparts = { white = 0.75 }\n",
                "chart.toml: mixture[0].parts of pale = a sum of 0.750000 is not valid: volume fractions must add up to 1",
            ),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(message), "{error}");
        }
    }
}
