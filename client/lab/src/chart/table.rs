//! Reads charts as tables: a row for each patch with `slabs,L,a,b`, or for each patch and channel with
//! `slabs,channel,value`; further columns are `std_error`, `patch`, `photo`, `row`, `column`, `base` and `geometry`.

use std::collections::HashMap;

use anyhow::{Context, Result, bail};
use optics_chart::linear_srgb;

use super::patch::{CAMERA, NamedPatch, PatchPlace, REST, check_colour};
use super::settings::PatchGeometry;
use crate::measurement_file::{is_missing, normal};
use crate::slabs;

/// Columns, with other names of them.
const COLUMNS: [(&str, &[&str]); 14] = [
    ("slabs", &["stack", "layers"]),
    ("channel", &["wavelength", "wavelength_nm"]),
    ("value", &["reflectance", "radiance_factor", "transmittance"]),
    ("std_error", &["std", "sd", "uncertainty"]),
    ("l", &["l*", "lab_l", "cielab_l"]),
    ("a", &["a*", "lab_a", "cielab_a"]),
    ("b", &["b*", "lab_b", "cielab_b"]),
    ("patch", &["name", "id"]),
    ("photo", &["photograph", "image"]),
    ("row", &[]),
    ("column", &["col"]),
    ("base", &["over"]),
    ("geometry", &[]),
    ("note", &["comment"]),
];

/// A table with known columns.
struct PatchTable<'a> {
    columns: Vec<&'static str>,
    separator: u8,
    text: &'a str,
}

/// The cells of a row by their columns.
struct StackRow {
    line: u64,
    cells: HashMap<&'static str, String>,
    is_comma_decimal: bool,
}

fn known(name: &str) -> Option<&'static str> {
    let name = name.trim().trim_start_matches('\u{feff}').to_lowercase();
    COLUMNS.iter().find(|(own, others)| *own == name || others.contains(&name.as_str())).map(|(own, _)| *own)
}

/// The line with the names of the columns, and what separates them.
fn head(text: &str) -> Option<(&str, u8)> {
    let line = text.lines().find(|line| !line.trim().is_empty() && !line.starts_with('#'))?;
    [b',', b';', b'\t'].into_iter().find_map(|separator| {
        let mut names = line.split(char::from(separator));
        names.any(|name| known(name.trim_matches('"')) == Some("slabs")).then_some((line, separator))
    })
}

/// Whether a text is such a table.
pub(super) fn is(text: &str) -> bool {
    head(text).is_some()
}

/// Patches with their values by channel; whether the values are colours.
pub(super) fn patches(text: &str) -> Result<(Vec<NamedPatch>, Vec<String>, bool)> {
    let (line, separator) = head(text).context("no column slabs")?;
    let names = line.split(char::from(separator)).map(|name| name.trim().trim_matches('"'));
    let column = |name: &str| {
        let allowed = COLUMNS.map(|(name, _)| name).join(", ");
        known(name).with_context(|| format!("column {name:?} is not known; the columns are {allowed}"))
    };
    let columns: Vec<&'static str> = names.map(column).collect::<Result<_>>()?;
    if let Some(twice) = (1..columns.len()).find(|i| columns[..*i].contains(&columns[*i])) {
        bail!("column {:?} occurs twice", columns[twice]);
    }
    let has = |names: &[&str]| names.iter().all(|name| columns.contains(name));
    let table = PatchTable { columns: columns.clone(), separator, text };
    match (has(&["l", "a", "b"]), has(&["channel", "value"])) {
        (true, false) => Ok((table.colours()?, CAMERA.map(str::to_owned).to_vec(), true)),
        (false, true) => {
            let (patches, channels) = table.channels()?;
            Ok((patches, channels, false))
        }
        _ => bail!("a chart has the columns slabs, L, a and b, or slabs, channel and value"),
    }
}

impl PatchTable<'_> {
    fn rows(&self) -> impl Iterator<Item = Result<StackRow>> {
        let reader = csv::ReaderBuilder::new()
            .delimiter(self.separator)
            .comment(Some(b'#'))
            .trim(csv::Trim::All)
            .has_headers(true)
            .flexible(true)
            .from_reader(self.text.as_bytes());
        let is_comma_decimal = self.separator != b',';
        reader.into_records().map(move |record| {
            let record = record.map_err(|error| anyhow::anyhow!("{error}"))?;
            let line = record.position().map_or(0, csv::Position::line);
            if record.len() != self.columns.len() {
                bail!("line {line}: it has {} cells, the columns are {}", record.len(), self.columns.len());
            }
            let cells = self.columns.iter().copied().zip(record.iter().map(ToOwned::to_owned)).collect();
            Ok(StackRow { line, cells, is_comma_decimal })
        })
    }

    /// One patch for each row.
    fn colours(&self) -> Result<Vec<NamedPatch>> {
        let (mut patches, mut rows) = (Vec::new(), 0);
        for row in self.rows() {
            let row = row?;
            rows += 1;
            let numbers = [row.number("l")?, row.number("a")?, row.number("b")?];
            let [Some(l), Some(a), Some(b)] = numbers else { continue };
            check_colour([l, a, b]).with_context(|| format!("line {}", row.line))?;
            let name = row.cell("patch").map_or_else(|| (patches.len() + 1).to_string(), str::to_owned);
            patches.push(row.patch(name, linear_srgb([l, a, b]).to_vec())?);
        }
        if patches.is_empty() && rows > 0 {
            bail!("none of its {rows} patches has a colour: fill in L, a and b");
        }
        Ok(patches)
    }

    /// One patch for the rows of one stack, name, place, base and geometry; a channel that occurs again begins another.
    fn channels(&self) -> Result<(Vec<NamedPatch>, Vec<String>)> {
        let mut found: Vec<(NamedPatch, HashMap<String, [f64; 2]>)> = Vec::new();
        let mut last: HashMap<Vec<String>, usize> = HashMap::new();
        let mut channels: Vec<String> = Vec::new();
        for row in self.rows() {
            let row = row?;
            let channel =
                row.cell("channel").with_context(|| format!("line {}: channel is missing", row.line))?;
            let channel = normal(channel).into_owned();
            let Some(value) = row.number("value")? else { continue };
            let std_error = row.number("std_error")?.unwrap_or(0.0);
            if !(-0.1..=3.0).contains(&value) || !(0.0..=1.0).contains(&std_error) {
                bail!(
                    "line {}: value = {value}, std_error = {std_error}: allowed are -0.1 to 3, 1 being white, and 0 to 1",
                    row.line
                );
            }
            if !channels.contains(&channel) {
                channels.push(channel.clone());
            }
            let key: Vec<String> = ["slabs", "patch", "photo", "row", "column", "base", "geometry"]
                .map(|name| row.cell(name).unwrap_or_default().to_owned())
                .to_vec();
            let known = last.get(&key).copied().filter(|patch| !found[*patch].1.contains_key(&channel));
            let patch = known.unwrap_or(found.len());
            if known.is_none() {
                let name = row.cell("patch").map_or_else(|| (patch + 1).to_string(), str::to_owned);
                found.push((row.patch(name, Vec::new())?, HashMap::new()));
            }
            last.insert(key, patch);
            found[patch].1.insert(channel, [value, std_error]);
        }
        let is_whole = |(_, values): &&(NamedPatch, HashMap<_, _>)| values.len() == channels.len();
        if let Some((patch, values)) = found.iter().find(|patch| !is_whole(patch)) {
            bail!(
                "patch {}: it has {} of the {} channels {}",
                patch.name,
                values.len(),
                channels.len(),
                channels.join(", ")
            );
        }
        let whole = |(mut patch, values): (NamedPatch, HashMap<String, [f64; 2]>)| {
            (patch.values, patch.std_errors) = channels.iter().map(|c| (values[c][0], values[c][1])).unzip();
            patch
        };
        Ok((found.into_iter().map(whole).collect(), channels.clone()))
    }
}

impl StackRow {
    /// The text of a cell that is not empty.
    fn cell(&self, name: &str) -> Option<&str> {
        self.cells.get(name).map(String::as_str).filter(|text| !text.is_empty())
    }

    fn number(&self, name: &str) -> Result<Option<f64>> {
        let Some(text) = self.cell(name).filter(|text| !is_missing(text)) else { return Ok(None) };
        let plain = text.replace('\u{2212}', "-");
        let plain = if self.is_comma_decimal { plain.replace(',', ".") } else { plain };
        let number = plain.parse().ok().filter(|v: &f64| v.is_finite());
        number.map(Some).with_context(|| format!("line {}: {name} = {text:?} is no number", self.line))
    }

    fn patch(&self, name: String, values: Vec<f64>) -> Result<NamedPatch> {
        let place = || format!("line {}", self.line);
        let stack = self.cell("slabs").context("slabs is missing").with_context(place)?;
        let stack = normal(stack);
        let stack = if self.is_comma_decimal && !stack.contains('=') {
            stack.replace(',', ".")
        } else {
            stack.into_owned()
        };
        let slabs = slabs::stack(&stack).with_context(place)?;
        let geometry = |text: &str| {
            let found = PatchGeometry::ALL.iter().find(|(name, _)| name.eq_ignore_ascii_case(text));
            let allowed = PatchGeometry::ALL.map(|(name, _)| name).join(", ");
            found.map(|(_, found)| *found).with_context(|| {
                format!("line {}: geometry = {text:?} is not valid: allowed are {allowed}", self.line)
            })
        };
        let coordinates = [self.number("column")?, self.number("row")?];
        let photo = self.cell("photo").unwrap_or("1").to_owned();
        Ok(NamedPatch {
            base: self.cell("base").unwrap_or(REST).to_owned(),
            geometry: self.cell("geometry").map(geometry).transpose()?,
            place: match coordinates {
                [Some(column), Some(row)] => Some(PatchPlace { photo, column, row }),
                [None, None] => None,
                _ => bail!("line {}: row and column are given together", self.line),
            },
            ..NamedPatch::new(name, slabs, values)
        })
    }
}
