//! What the checks found, with the places in the file.

use anyhow::{Result, bail};
use optics_model::measurement::checks::{Finding, check};

use super::note::Note;
use super::rows::{Profiles, place_of};

/// Refuses what is certainly wrong; the rest becomes notes, one of a kind.
pub(super) fn examine(profiles: &Profiles, notes: &mut Vec<Note>) -> Result<()> {
    let findings = check(&profiles.materials);
    if let Some(first) = findings.iter().find(|f| f.certain) {
        let alike = findings.iter().filter(|f| f.certain && f.kind == first.kind);
        bail!("{}", told(profiles, first, alike.count()));
    }
    let mut kinds: Vec<_> = findings.iter().map(|f| f.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    for kind in kinds {
        let alike: Vec<&Finding> = findings.iter().filter(|f| f.kind == kind).collect();
        notes.push(Note::new(kind.code(), told(profiles, alike[0], alike.len())));
    }
    Ok(())
}

fn told(profiles: &Profiles, finding: &Finding, count: usize) -> String {
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
