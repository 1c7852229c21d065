//! Mixtures of inks: their parts, and the inks' media found from them.
//!
//! In a mixture with volume fractions `f_i` scattering and absorption add: σ_s = Σ f_i σ_s,i, σ_a = Σ f_i σ_a,i and
//! σ_s (1 − g) = Σ f_i σ_s,i (1 − g_i).

use serde::Serialize;

use super::answer::{Common, Interval, MaterialFit, Refined, is_default};
use crate::descent::DescentEnd;
use crate::invalid::{Invalid, Result};
use crate::medium::Medium;

/// Largest deviation of a sum of volume fractions from 1: decimals in files are rounded.
const ROUNDED: f64 = 0.005;

/// One ink in a mixture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MixturePart {
    ink: String,
    volume_fraction: f64,
}

impl MixturePart {
    /// Unchecked: a [`Mixture`] checks its parts.
    pub fn new(ink: impl Into<String>, volume_fraction: f64) -> Self {
        Self { ink: ink.into(), volume_fraction }
    }

    pub fn ink(&self) -> &str {
        &self.ink
    }

    pub fn volume_fraction(&self) -> f64 {
        self.volume_fraction
    }
}

/// A measured material that is made of others.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mixture {
    material: String,
    parts: Vec<MixturePart>,
}

impl Mixture {
    /// Volume fractions by ink. They are divided by their sum, which rounding may keep from being 1.
    pub fn new(material: impl Into<String>, parts: impl IntoIterator<Item = (String, f64)>) -> Result<Self> {
        let material = material.into();
        let field = format!("parts of {material}");
        let mut all: Vec<MixturePart> = Vec::new();
        for (ink, volume_fraction) in parts {
            if !(volume_fraction > 0.0 && volume_fraction <= 1.0) {
                let given = format!("{ink} = {volume_fraction}");
                return Err(Invalid::new(field, given, "volume fractions above 0 and up to 1 are allowed"));
            }
            if ink == material {
                return Err(Invalid::new(field, ink, "a mixture cannot be a part of itself"));
            }
            if all.iter().any(|p| p.ink == ink) {
                return Err(Invalid::new(field, ink, "each ink may be listed once"));
            }
            all.push(MixturePart { ink, volume_fraction });
        }
        // An empty sum is −0.
        let sum = 0.0 + all.iter().map(|p| p.volume_fraction).sum::<f64>();
        if (sum - 1.0).abs() > ROUNDED {
            let given = format!("a sum of {sum:.6}");
            return Err(Invalid::new(field, given, "volume fractions must add up to 1"));
        }
        for part in &mut all {
            part.volume_fraction /= sum;
        }
        Ok(Self { material, parts: all })
    }

    pub fn material(&self) -> &str {
        &self.material
    }

    pub fn parts(&self) -> &[MixturePart] {
        &self.parts
    }
}

/// Mixtures of inks that are no mixtures themselves.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Mixtures(Vec<Mixture>);

impl Mixtures {
    pub fn new(all: Vec<Mixture>) -> Result<Self> {
        if all.is_empty() {
            return Err(Invalid::new("mixture", "none", "at least one is needed"));
        }
        for (i, mixture) in all.iter().enumerate() {
            if all[..i].iter().any(|m| m.material == mixture.material) {
                return Err(Invalid::new("mixture", &mixture.material, "each may be listed once"));
            }
            let mixed = |p: &&MixturePart| all.iter().any(|m| m.material == p.ink && m.parts.len() > 1);
            if let Some(part) = mixture.parts.iter().find(mixed) {
                let allowed = format!("{} is a mixture itself: list its inks instead", part.ink);
                return Err(Invalid::new(format!("parts of {}", mixture.material), &part.ink, allowed));
            }
        }
        Ok(Self(all))
    }

    pub fn all(&self) -> &[Mixture] {
        &self.0
    }

    /// Names of the inks, in the order in which they are given.
    pub fn inks(&self) -> Vec<&str> {
        let mut inks: Vec<&str> = Vec::new();
        for part in self.0.iter().flat_map(|m| &m.parts) {
            if !inks.contains(&part.ink.as_str()) {
                inks.push(&part.ink);
            }
        }
        inks
    }

    /// The inks of a material with their volume fractions: those of a mixture, or an ink by itself. None if it is
    /// neither.
    pub fn parts_of<'a>(&'a self, material: &'a str) -> Option<Vec<(&'a str, f64)>> {
        match self.0.iter().find(|m| m.material == material) {
            Some(m) => Some(m.parts.iter().map(|p| (p.ink.as_str(), p.volume_fraction)).collect()),
            None => self.inks().contains(&material).then(|| vec![(material, 1.0)]),
        }
    }
}

/// The joint solution for pure inks and their mixtures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unmixed {
    /// The parameters that all channels share, from pure inks and mixtures.
    pub common: Common,
    pub inks: Vec<InkFit>,
    /// The fits of mixtures, pure inks included.
    pub mixtures: Vec<MixtureFit>,
}

impl Unmixed {
    /// Replaces the results that an ink's own slabs leave undetermined by those of the joint solution.
    pub fn replace(&self, materials: &mut [MaterialFit]) {
        for ink in &self.inks {
            let Some(material) = materials.iter_mut().find(|m| m.material == ink.material) else { continue };
            for found in ink.channels.iter().filter(|c| c.from_mixtures) {
                let same = material.channels.iter_mut().find(|c| c.channel == found.channel);
                if let Some(refined) = same.and_then(|c| c.refined.as_mut()) {
                    found.replace(refined);
                }
            }
        }
    }
}

/// An ink in all channels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InkFit {
    pub material: String,
    pub channels: Vec<InkChannel>,
}

/// An ink in one channel. Open ends of intervals are the limits of the search: the data allow values beyond them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InkChannel {
    pub channel: String,
    #[serde(flatten)]
    pub medium: Medium,
    #[serde(rename = "sigma_t_interval")]
    pub sigma_t_per_mm: Interval,
    #[serde(rename = "albedo_interval")]
    pub albedo: Interval,
    #[serde(rename = "g_interval")]
    pub g: Interval,
    #[serde(rename = "reduced_scattering_interval")]
    pub reduced_scattering_per_mm: Interval,
    #[serde(rename = "absorption_interval")]
    pub absorption_per_mm: Interval,
    /// Whether all measurements together determine σ_t, and the albedo or 1 − α.
    pub resolved: bool,
    /// The ink's own slabs, if there are any, do not determine them.
    pub from_mixtures: bool,
    /// How the descent of all inks ended, as in [`Refined`].
    #[serde(skip_serializing_if = "is_default")]
    pub descent: DescentEnd,
}

impl InkChannel {
    fn replace(&self, refined: &mut Refined) {
        refined.best.medium = self.medium;
        refined.sigma_t_per_mm = self.sigma_t_per_mm;
        refined.albedo = self.albedo;
        refined.g = self.g;
        refined.reduced_scattering_per_mm = self.reduced_scattering_per_mm;
        refined.absorption_per_mm = self.absorption_per_mm;
        (refined.resolved, refined.resolved_at_g) = (self.resolved, self.resolved);
        (refined.from_mixtures, refined.descent) = (true, self.descent);
        // The values from the slabs alone belong to another medium.
        (refined.covariance, refined.correlation, refined.valley) = ([[0.0; 3]; 3], 0.0, false);
    }
}

/// The fit of one channel of a measured material by its inks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MixtureFit {
    pub material: String,
    pub channel: String,
    pub parts: Vec<MixturePart>,
    /// The medium that the parts make up.
    #[serde(flatten)]
    pub medium: Medium,
    /// None if it was left out.
    #[serde(flatten)]
    pub agreement: Option<Agreement>,
    /// The reason for leaving it out of the joint solution.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_out: Option<String>,
}

/// Agreement of profiles with their inks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Agreement {
    /// Sum of the squares of the residuals over their noise, and of the deviations of the profiles' set-ups.
    pub chi2: f64,
    pub pixels: f64,
    /// Root mean square of the residuals over their noise: 1 if noise explains all.
    pub misfit: f64,
    /// Deviation of σ_t and α of the inks' medium from the values that these profiles determine by themselves, in
    /// standard errors: root mean square of the two. A wrong volume fraction shows here.
    pub pull: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mixture(material: &str, parts: &[(&str, f64)]) -> Result<Mixture> {
        Mixture::new(material, parts.iter().map(|(ink, f)| ((*ink).to_owned(), *f)))
    }

    /// Fractions that do not add up to 1, repeat a part or are out of range are refused.
    #[test]
    fn invalid_fractions_are_refused() {
        for (parts, told) in [
            (&[("white", 0.5), ("cyan", 0.4)][..], "add up to 1"),
            (&[("white", 1.5), ("cyan", -0.5)], "above 0"),
            (&[("white", f64::NAN)], "above 0"),
            (&[("white", 0.5), ("white", 0.5)], "once"),
            (&[("both", 1.0)], "itself"),
            (&[], "a sum of 0"),
        ] {
            let error = mixture("both", parts).unwrap_err();
            assert!(error.field() == "parts of both" && error.to_string().contains(told), "{error}");
        }
        let third = mixture("m", &[("a", 0.333), ("b", 0.333), ("c", 0.333)]).unwrap();
        assert!((third.parts()[0].volume_fraction() - 1.0 / 3.0).abs() < 1e-12);
    }

    /// The inks are the parts of which mixtures consist.
    #[test]
    fn inks_are_the_parts_of_mixtures() {
        let both = mixture("both", &[("white", 0.5), ("cyan", 0.5)]).unwrap();
        let all = Mixtures::new(vec![both.clone()]).unwrap();
        assert_eq!(all.inks(), ["white", "cyan"]);
        assert_eq!(all.parts_of("cyan"), Some(vec![("cyan", 1.0)]));
        assert_eq!(all.parts_of("both"), Some(vec![("white", 0.5), ("cyan", 0.5)]));
        assert_eq!(all.parts_of("red"), None);
        assert!(Mixtures::new(vec![both.clone(), both.clone()]).unwrap_err().to_string().contains("once"));
        let nested = mixture("nested", &[("both", 0.5), ("white", 0.5)]).unwrap();
        let error = Mixtures::new(vec![both, nested]).unwrap_err();
        assert!(error.to_string().contains("a mixture itself"), "{error}");
        assert_eq!(Mixtures::new(vec![]).unwrap_err().field(), "mixture");
    }
}
