//! Converts the errors that media and set-up share.

use super::mirror::list;
use crate::wire;
use optics_model::fit::{SetUpDifference, SharedErrors};
use optics_model::invalid::{Invalid, Result};

impl From<SharedErrors> for wire::SharedErrors {
    fn from(errors: SharedErrors) -> Self {
        Self {
            sources: errors.sources as u32,
            media: errors.media.concat(),
            scene: list::to_wire(errors.scene),
        }
    }
}

impl TryFrom<wire::SharedErrors> for SharedErrors {
    type Error = Invalid;

    fn try_from(errors: wire::SharedErrors) -> Result<Self> {
        let sources = errors.sources as usize;
        let (media, rest) = errors.media.as_chunks();
        if !rest.is_empty() || (sources == 0) != media.is_empty() || media.len() % sources.max(1) != 0 {
            let allowed = format!("{} numbers are needed for each channel and source", Self::OF_MEDIUM);
            return Err(Invalid::new("media", format!("{} numbers", errors.media.len()), allowed));
        }
        let scene: Vec<SetUpDifference> = list::from_wire("scene", errors.scene)?;
        if let Some(other) = scene.iter().find(|d| d.changes.len() != sources) {
            let allowed = format!("a number is needed for each of {sources} sources");
            return Err(Invalid::new("scene.changes", format!("{} numbers", other.changes.len()), allowed));
        }
        Ok(Self { sources, media: media.to_vec(), scene })
    }
}

impl From<SetUpDifference> for wire::SetUpDifference {
    fn from(d: SetUpDifference) -> Self {
        let [material, channel] = [d.material, d.channel].map(|of| of.map(|i| i as u32));
        Self { prior: d.prior as u32, material, channel, difference: d.difference, changes: d.changes }
    }
}

impl TryFrom<wire::SetUpDifference> for SetUpDifference {
    type Error = Invalid;

    fn try_from(d: wire::SetUpDifference) -> Result<Self> {
        let [material, channel] = [d.material, d.channel].map(|of| of.map(|i| i as usize));
        Ok(Self { prior: d.prior as usize, material, channel, difference: d.difference, changes: d.changes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors() -> SharedErrors {
        let difference = |prior, material, channel, difference| SetUpDifference {
            prior,
            material,
            channel,
            difference,
            changes: vec![0.01, 0.2],
        };
        let scene = vec![difference(0, Some(1), Some(2), 0.02), difference(3, None, None, -0.5)];
        SharedErrors { sources: 2, media: vec![[1.0, 2.0, 3.0, 4.0, 5.0]; 6], scene }
    }

    #[test]
    fn shared_errors_survive_the_wire() {
        assert_eq!(SharedErrors::try_from(wire::SharedErrors::from(errors())).unwrap(), errors());
        assert_eq!(SharedErrors::try_from(wire::SharedErrors::default()).unwrap(), SharedErrors::default());
    }

    #[test]
    fn numbers_of_other_sources_are_refused() {
        let refused = |change: fn(&mut wire::SharedErrors)| {
            let mut errors = wire::SharedErrors::from(errors());
            change(&mut errors);
            SharedErrors::try_from(errors).unwrap_err().to_string()
        };
        assert!(refused(|e| e.media.push(0.0)).starts_with("media = 31 numbers"));
        assert!(refused(|e| e.sources = 3).contains("3 sources"));
        assert!(refused(|e| e.scene[0].changes.push(0.0)).starts_with("scene.changes = 3 numbers"));
    }
}
