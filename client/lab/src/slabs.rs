//! Parses slabs of prints: a material or a mixture by volume, with a thickness.

use anyhow::{Context, Result, bail};

/// A slab by the names of its materials.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedSlab {
    /// Materials and their shares by volume, which add up to 1.
    pub shares: Vec<(String, f64)>,
    pub thickness_mm: f64,
}

/// Largest deviation of the sum of shares from 1: shares are rounded.
const ROUNDED: f64 = 2e-3;

/// `MATERIAL:MM`, or `MATERIAL=SHARE,MATERIAL=SHARE:MM`; `is_material` finds names, which may contain any of the signs.
pub fn parsed(text: &str, is_material: impl Fn(&str) -> bool) -> Result<NamedSlab> {
    let form = || {
        format!("slab {text:?}: MATERIAL:MM or MATERIAL=SHARE,MATERIAL=SHARE:MM is needed, as in white:0.5")
    };
    let (materials, thickness) = text.rsplit_once(':').with_context(form)?;
    let thickness_mm: f64 = thickness.trim().parse().ok().with_context(form)?;
    optics_model::medium::check_thickness(thickness_mm).with_context(|| format!("slab {text:?}"))?;
    if is_material(materials) || !materials.contains('=') {
        return Ok(NamedSlab { shares: vec![(materials.to_owned(), 1.0)], thickness_mm });
    }
    let share = |part: &str| {
        let (name, share) = part.rsplit_once('=')?;
        Some((name.trim().to_owned(), share.trim().parse().ok().filter(|share| *share > 0.0)?))
    };
    let mut shares: Vec<(String, f64)> =
        materials.split(',').map(share).collect::<Option<_>>().with_context(form)?;
    if let Some(twice) =
        (1..shares.len()).find(|i| shares[..*i].iter().any(|(name, _)| *name == shares[*i].0))
    {
        bail!("slab {text:?}: {:?} may be given once", shares[twice].0);
    }
    let sum: f64 = shares.iter().map(|(_, share)| share).sum();
    if (sum - 1.0).abs() > ROUNDED {
        bail!("slab {text:?}: shares by volume must add up to 1, not {sum}");
    }
    for (_, share) in &mut shares {
        *share /= sum;
    }
    Ok(NamedSlab { shares, thickness_mm })
}

/// Slabs between blanks, from the top to the base; between `|` if names contain blanks.
pub fn stack(text: &str) -> Result<Vec<NamedSlab>> {
    let slab = |part: &str| parsed(part.trim(), |_| false);
    if text.contains('|') {
        text.split('|').map(slab).collect()
    } else {
        text.split_whitespace().map(slab).collect()
    }
}

impl NamedSlab {
    /// As it is typed: `white:0.5`, `white=0.9,cyan=0.1:0.5`.
    pub fn text(&self) -> String {
        let part = |(name, share): &(String, f64)| {
            if *share == 1.0 { name.clone() } else { format!("{name}={share}") }
        };
        let parts: Vec<String> = self.shares.iter().map(part).collect();
        format!("{}:{}", parts.join(","), self.thickness_mm)
    }

    /// For display: `white 0.5 mm`, `90 % white + 10 % cyan 0.5 mm`.
    pub fn label(&self) -> String {
        let part = |(name, share): &(String, f64)| {
            if *share == 1.0 { name.clone() } else { format!("{} % {name}", (1000.0 * share).round() / 10.0) }
        };
        let parts: Vec<String> = self.shares.iter().map(part).collect();
        format!("{} {} mm", parts.join(" + "), self.thickness_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names may contain the signs of the form, if a material is called so.
    #[test]
    fn slabs_are_materials_or_mixtures() {
        let slab = |text: &str| parsed(text, |name| name == "a=b:c").unwrap();
        assert_eq!(slab("white:0.5").label(), "white 0.5 mm");
        assert_eq!(slab("a=b:c:2").label(), "a=b:c 2 mm");
        assert_eq!(slab("white=0.9, cyan=0.1:0.5").label(), "90 % white + 10 % cyan 0.5 mm");
        let thirds = slab("a=0.333,b=0.333,c=0.333:1");
        assert!((thirds.shares[0].1 - 1.0 / 3.0).abs() < 1e-12, "{thirds:?}");
    }

    #[test]
    fn wrong_slabs_are_refused() {
        for (text, message) in [
            ("white", "slab \"white\": MATERIAL:MM or"),
            ("white:thin", "slab \"white:thin\": MATERIAL:MM or"),
            ("white:0", "slab \"white:0\""),
            ("white=0.9,cyan=0.2:1", "must add up to 1, not 1.1"),
            ("white=1,cyan=-1:1", "MATERIAL:MM or"),
            ("white=0.5,white=0.5:1", "\"white\" may be given once"),
        ] {
            let error = format!("{:#}", parsed(text, |_| false).unwrap_err());
            assert!(error.contains(message), "{error}");
        }
    }
}
