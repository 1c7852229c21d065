//! Joins names that look identical, and notes names and thicknesses that look alike.

use std::borrow::Cow;
use std::collections::BTreeMap;

use unicode_normalization::UnicodeNormalization as _;

use super::note::Note;

/// Thicknesses closer than this are probably those of one slab: none is measured that precisely.
const ONE_SLAB_MM: f64 = 1e-3;

/// A name in composed characters, with plain blanks and without invisible characters.
pub fn normal(name: &str) -> Cow<'_, str> {
    if name.is_ascii() {
        return Cow::Borrowed(name);
    }
    let is_unseen =
        |c: char| matches!(c, '\u{ad}' | '\u{200b}' | '\u{200e}' | '\u{200f}' | '\u{2060}' | '\u{feff}');
    let seen = name.chars().filter(|c| !is_unseen(*c)).map(|c| if c.is_whitespace() { ' ' } else { c });
    Cow::Owned(seen.nfc().collect::<String>().trim().to_owned())
}

/// Spellings of names, each with the line of its first row.
#[derive(Debug, Default)]
pub(super) struct Spellings(BTreeMap<String, Vec<(String, u64)>>);

impl Spellings {
    /// The normal form of a name; records its spelling.
    pub fn read<'a>(&mut self, given: &'a str, line: u64) -> Cow<'a, str> {
        let name = normal(given);
        // ASCII names need no record of their spelling.
        if !given.is_ascii() {
            let spellings = self.0.entry(name.to_string()).or_default();
            if spellings.iter().all(|(known, _)| known != given) {
                spellings.push((given.to_owned(), line));
            }
        }
        name
    }

    /// A note of the names that were joined.
    pub fn note(&self) -> Option<Note> {
        // An ASCII name is not recorded, so one other spelling of it suffices.
        let joined = self.0.iter().filter(|(name, spellings)| spellings.len() > 1 || name.is_ascii());
        let described = joined.map(|(name, spellings)| {
            let lines: Vec<String> = spellings.iter().map(|(_, line)| line.to_string()).collect();
            format!("{name:?} (line {})", lines.join(" and "))
        });
        let described: Vec<String> = described.collect();
        let text = format!(
            "names in different characters that look the same are read as one: {}",
            described.join(", ")
        );
        (!described.is_empty()).then(|| Note::new("NAMES", text))
    }
}

/// A note of names that differ in case or separators only, given with the line of their first row; `what` names their
/// kind.
pub(super) fn alike<'a>(what: &str, names: impl Iterator<Item = (&'a str, u64)>) -> Option<Note> {
    let mut groups: BTreeMap<String, Vec<(&str, u64)>> = BTreeMap::new();
    for (name, line) in names {
        let key = name.to_lowercase().chars().filter(|c| !" _-".contains(*c)).collect();
        let group = groups.entry(key).or_default();
        if group.iter().all(|(known, _)| *known != name) {
            group.push((name, line));
        }
    }
    let described = groups.values().filter(|group| group.len() > 1).map(|group| {
        let each: Vec<String> = group.iter().map(|(name, line)| format!("{name:?} (line {line})")).collect();
        each.join(" and ")
    });
    let described: Vec<String> = described.collect();
    let text =
        format!("{what} with names that look alike are taken for different ones: {}", described.join("; "));
    (!described.is_empty()).then(|| Note::new("ALIKE_NAMES", text))
}

/// A note on thicknesses of one material that are probably one slab, each with the line of its first row.
pub(super) fn alike_thicknesses(thicknesses: &mut [(f64, u64)]) -> Option<String> {
    thicknesses.sort_by(|a, b| a.0.total_cmp(&b.0));
    let close = |pair: &&[(f64, u64)]| pair[0].0 < pair[1].0 && pair[1].0 - pair[0].0 < ONE_SLAB_MM;
    let pair = thicknesses.windows(2).find(close)?;
    let [(first, line), (second, other)] = [pair[0], pair[1]];
    Some(format!(
        "thicknesses {first} mm (line {line}) and {second} mm (line {other}) are taken for two slabs; if it is one, \
         write one thickness"
    ))
}
