//! Turns the findings of the checks into errors and notes with their position in the file.

use anyhow::{Result, bail};
use optics_model::Measurement;
use optics_model::limits::FitLimits;
use optics_model::measurement::checks::{Finding, check};

use super::note::Note;
use super::rows::{Profiles, place_of};

/// Refuses certain errors; other findings become notes, one of each kind.
pub(super) fn examine(profiles: &Profiles, notes: &mut Vec<Note>) -> Result<()> {
    let findings = check(&profiles.materials);
    if let Some(first) = findings.iter().find(|f| f.certain) {
        let alike = findings.iter().filter(|f| f.certain && f.kind == first.kind);
        bail!("{}", described(profiles, first, alike.count()));
    }
    let mut kinds: Vec<_> = findings.iter().map(|f| f.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    for kind in kinds {
        let alike: Vec<&Finding> = findings.iter().filter(|f| f.kind == kind).collect();
        notes.push(Note::new(kind.code(), described(profiles, alike[0], alike.len())));
    }
    Ok(())
}

/// Limits of a coordinator that a question about all materials of a file would exceed.
pub fn beyond_limits(materials: &[Measurement]) -> Vec<Note> {
    let pixels: usize = materials.iter().flat_map(Measurement::profiles).map(|p| p.values().len()).sum();
    let (most_pixels, most_materials) = (FitLimits::QUESTION_PIXELS, FitLimits::MATERIALS);
    let mut notes = Vec::new();
    if pixels > most_pixels {
        let advice = FitLimits::MANY_PIXELS_ADVICE;
        let text = format!(
            "{pixels} pixels, but a coordinator accepts at most {most_pixels} in one request; {advice}"
        );
        notes.push(Note::new("MANY_PIXELS", text));
    }
    if materials.len() > most_materials {
        let count = materials.len();
        let text = format!(
            "{count} materials, but `measure` accepts at most {most_materials}; measure several files"
        );
        notes.push(Note::new("MANY_MATERIALS", text));
    }
    notes
}

fn described(profiles: &Profiles, finding: &Finding, count: usize) -> String {
    let material = &profiles.materials[finding.material];
    let profile = &material.profiles()[finding.profile];
    let line = profiles.lines[finding.material][finding.profile][finding.pixel.unwrap_or(0)];
    let place = place_of(line, material.material(), profile.channel(), profile.thickness_mm());
    let more = match count {
        0 | 1 => String::new(),
        2 => " (the same in one more profile)".to_owned(),
        n => format!(" (the same in {} more profiles)", n - 1),
    };
    format!("{place}: {}{more}", finding.text)
}

#[cfg(test)]
mod tests {
    use optics_model::MeasuredProfile;

    use super::*;

    /// A measurement beyond the limits of a coordinator gets a note.
    #[test]
    fn coordinator_limits_are_noted() {
        let x: Vec<f64> = (0..FitLimits::PIXELS).map(|i| i as f64 * 1e-3).collect();
        let profile =
            |i: usize| MeasuredProfile::new(i.to_string(), 1.0, x.clone(), x.clone(), None).unwrap();
        let measurement = |n: usize| Measurement::new("white", (0..n).map(profile).collect()).unwrap();
        assert_eq!(beyond_limits(&[measurement(10)]), []);
        let many = beyond_limits(&[measurement(6), measurement(5)]);
        assert_eq!(many.iter().map(|n| n.code).collect::<Vec<_>>(), ["MANY_PIXELS"]);
        let wanted = "1100000 pixels, but a coordinator accepts at most 1048576 in one request; request fewer materials";
        assert!(many[0].text.starts_with(wanted), "{}", many[0].text);
        let small =
            Measurement::new("white", vec![MeasuredProfile::patch("R", 1.0, 0.5, 0.01).unwrap()]).unwrap();
        assert_eq!(beyond_limits(&vec![small; 257])[0].code, "MANY_MATERIALS");
    }
}
