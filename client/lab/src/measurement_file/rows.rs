//! Assembles rows into profiles.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail};
use optics_model::measurement::{ProfileSetup, colour};
use optics_model::{Invalid, MeasuredProfile, Measurement};

use super::columns::{Column, are_units};
use super::names::{Spellings, alike, alike_thicknesses};
use super::note::Note;
use super::number::{Decimal, is_missing};
use super::pixels::{AssumedPixels, FileRow, Pixels};
use super::table::Table;

/// One profile while its rows are being read.
pub(super) struct ProfileDraft {
    material: String,
    channel: String,
    thickness_mm: f64,
    setup: ProfileSetup,
    rows: Vec<FileRow>,
}

/// Profiles of a file, ordered by material, and the line of each of their pixels.
pub(super) struct Profiles {
    pub materials: Vec<Measurement>,
    /// `[material][profile][pixel]`.
    pub lines: Vec<Vec<Vec<u64>>>,
}

/// All rows, grouped into profiles in the order of their first rows.
pub(super) fn drafts(table: &Table, decimal: Decimal, notes: &mut Vec<Note>) -> Result<Vec<ProfileDraft>> {
    let (mut drafts, mut spellings) = (Vec::new(), Spellings::default());
    for row in table.rows() {
        let (line, row) = row?;
        let cells = || table.columns.numbers().map(|c| &row[c.place]).collect::<Vec<_>>();
        if drafts.is_empty() && are_units(&cells()) {
            bail!(
                "line {line} seems to hold units: leave it out, and write them in the columns' names, as in x (µm)"
            );
        }
        add(&mut drafts, &mut spellings, line, &row, table, decimal)
            .with_context(|| format!("line {line}"))?;
    }
    notes.extend(spellings.note());
    if drafts.is_empty() {
        bail!("no rows");
    }
    Ok(drafts)
}

fn add(
    drafts: &mut Vec<ProfileDraft>,
    spellings: &mut Spellings,
    line: u64,
    row: &csv::StringRecord,
    table: &Table,
    decimal: Decimal,
) -> Result<()> {
    let columns = &table.columns;
    let number = |c: Column| Ok::<_, anyhow::Error>(decimal.read(&row[c.place], c.name)? * c.factor);
    let material = spellings.read(&row[columns.material.place], line);
    let channel = spellings.read(&row[columns.channel.place], line);
    let thickness_mm = number(columns.thickness)?;
    let entry = FileRow {
        line,
        x_mm: Some(columns.x).filter(|c| !row[c.place].is_empty()).map(number).transpose()?,
        value: Some(columns.value).filter(|c| !is_missing(&row[c.place])).map(number).transpose()?,
        std_error: columns.std_error.filter(|c| !is_missing(&row[c.place])).map(number).transpose()?,
    };
    let mut setup = ProfileSetup::default();
    for ((_, known), column) in setup.values_mut().zip(columns.setup) {
        // An empty cell means that this profile has no value.
        *known = column.filter(|c| !row[c.place].is_empty()).map(number).transpose()?;
    }
    let same =
        |d: &ProfileDraft| d.material == material && d.channel == channel && d.thickness_mm == thickness_mm;
    // Rows of a profile are mostly adjacent: the last draft is tried first.
    match drafts.iter().rposition(same) {
        Some(place) => {
            check_same(&drafts[place], setup)?;
            drafts[place].rows.push(entry);
        }
        None => drafts.push(ProfileDraft {
            material: material.into_owned(),
            channel: channel.into_owned(),
            thickness_mm,
            setup,
            rows: vec![entry],
        }),
    }
    Ok(())
}

/// Checks that all rows of a profile have the same set-up.
fn check_same(draft: &ProfileDraft, setup: ProfileSetup) -> Result<()> {
    for ((quantity, here), (_, before)) in setup.values().zip(draft.setup.values()) {
        if here != before {
            let described = |v: Option<f64>| v.map_or("nothing".to_owned(), |v| v.to_string());
            let (here, before, line) = (described(here), described(before), draft.rows[0].line);
            bail!(
                "{} = {here}, but line {line} of the same profile has {before}: it must be the same in all rows of a profile",
                quantity.name
            );
        }
    }
    Ok(())
}

/// Renames the channels to R, G and B if all of them are colours, in any spelling.
pub(super) fn name_colours(drafts: &mut [ProfileDraft], notes: &mut Vec<Note>) -> Result<()> {
    if drafts.iter().any(|d| colour(&d.channel).is_none()) {
        return Ok(());
    }
    let mut renamed: Vec<String> = Vec::new();
    for i in 0..drafts.len() {
        let name = colour(&drafts[i].channel).context("every channel is a colour")?;
        let twin = drafts[..i].iter().find(|d| {
            let same_slab = d.material == drafts[i].material && d.thickness_mm == drafts[i].thickness_mm;
            same_slab && d.channel == name
        });
        if twin.is_some() {
            let ProfileDraft { material, channel, thickness_mm, rows, .. } = &drafts[i];
            bail!(
                "line {}, material {material}, {thickness_mm} mm: channel {channel:?} means {name}, which is there under another spelling: are these two profiles or one?",
                rows[0].line
            );
        }
        if drafts[i].channel != name {
            let described = format!("{:?} is read as {name}", drafts[i].channel);
            if !renamed.contains(&described) {
                renamed.push(described);
            }
            name.clone_into(&mut drafts[i].channel);
        }
    }
    if !renamed.is_empty() {
        notes.push(Note::new("CHANNELS", format!("channels: {}", renamed.join(", "))));
    }
    Ok(())
}

/// Notes names and thicknesses that look alike.
pub(super) fn look_alike(drafts: &[ProfileDraft], notes: &mut Vec<Note>) {
    notes.extend(alike("materials", drafts.iter().map(|d| (d.material.as_str(), d.rows[0].line))));
    notes.extend(alike("channels", drafts.iter().map(|d| (d.channel.as_str(), d.rows[0].line))));
    let mut slabs: BTreeMap<&str, Vec<(f64, u64)>> = BTreeMap::new();
    for draft in drafts {
        slabs.entry(&draft.material).or_default().push((draft.thickness_mm, draft.rows[0].line));
    }
    let described = slabs
        .iter_mut()
        .filter_map(|(material, of)| Some(format!("material {material}: {}", alike_thicknesses(of)?)));
    let described: Vec<String> = described.collect();
    if !described.is_empty() {
        notes.push(Note::new("ALIKE_THICKNESSES", described.join("; ")));
    }
}

/// Sorts rows that do not increase in x.
pub(super) fn sort(drafts: &mut [ProfileDraft], notes: &mut Vec<Note>) -> Result<()> {
    let (mut falling, mut mixed) = (0, 0);
    // Patches are checked when they are made.
    for draft in drafts.iter_mut().filter(|d| d.rows.iter().all(|r| r.x_mm.is_some())) {
        let rows = &mut draft.rows;
        if rows.windows(2).all(|w| w[1].x() < w[0].x()) && rows.len() > 1 {
            falling += 1;
            rows.reverse();
        } else if rows.windows(2).any(|w| w[1].x() < w[0].x()) {
            mixed += 1;
            rows.sort_by(|a, b| a.x().total_cmp(&b.x()));
        }
        if let Some(twice) = rows.windows(2).find(|w| w[0].x() == w[1].x()) {
            let (first, second) = (twice[0].line.min(twice[1].line), twice[0].line.max(twice[1].line));
            let place = place_of(first, &draft.material, &draft.channel, draft.thickness_mm);
            bail!(
                "{place}: x_mm = {} stands here and in line {second}: x must be strictly rising, so a profile is given twice or two have the same names",
                twice[0].x()
            );
        }
    }
    let profiles = |n: usize| if n == 1 { "one profile".to_owned() } else { format!("{n} profiles") };
    let mut described = Vec::new();
    if falling > 0 {
        described.push(format!("x falls along {}, read from the other end", profiles(falling)));
    }
    if mixed > 0 {
        described.push(format!("the rows of {} are not in the order of x and were sorted", profiles(mixed)));
    }
    if !described.is_empty() {
        notes.push(Note::new("ORDER_OF_X", described.join("; ")));
    }
    Ok(())
}

/// Checked profiles, grouped by material.
pub(super) fn profiles(drafts: Vec<ProfileDraft>, notes: &mut Vec<Note>) -> Result<Profiles> {
    type Group = (String, Vec<MeasuredProfile>, Vec<Vec<u64>>);
    let (mut groups, mut described): (Vec<Group>, AssumedPixels) = (Vec::new(), AssumedPixels::default());
    for draft in drafts {
        let (profile, lines) = draft.made(&mut described)?;
        match groups.iter_mut().find(|(name, _, _)| *name == draft.material) {
            Some((_, profiles, all)) => {
                profiles.push(profile);
                all.push(lines);
            }
            None => groups.push((draft.material, vec![profile], vec![lines])),
        }
    }
    notes.extend(described.notes());
    let mut found = Profiles { materials: Vec::new(), lines: Vec::new() };
    for (material, profiles, lines) in groups {
        let place = format!("material {material}");
        found.materials.push(Measurement::new(material, profiles).context(place)?);
        found.lines.push(lines);
    }
    Ok(found)
}

impl ProfileDraft {
    /// A patch, with the default set-up.
    pub(super) fn patch_of(material: &str, channel: &str, thickness_mm: f64, patch: FileRow) -> Self {
        let (material, channel) = (material.to_owned(), channel.to_owned());
        Self { material, channel, thickness_mm, setup: ProfileSetup::default(), rows: vec![patch] }
    }

    fn place(&self, line: u64) -> String {
        place_of(line, &self.material, &self.channel, self.thickness_mm)
    }

    /// The profile, and the line of each of its pixels.
    fn made(&self, described: &mut AssumedPixels) -> Result<(MeasuredProfile, Vec<u64>)> {
        if let Some(patch) = self.rows.iter().find(|r| r.x_mm.is_none()) {
            let made = self.patch(patch)?.with_context(|| self.place(patch.line))?;
            let lines = vec![patch.line; made.values().len()];
            return Ok((made, lines));
        }
        let pixels = Pixels::of(&self.rows).with_context(|| self.place(self.rows[0].line))?;
        let Pixels { x_mm, values, std_errors, lines, missing } = pixels;
        let first = x_mm.clone();
        let made = MeasuredProfile::new(&self.channel, self.thickness_mm, x_mm, values, std_errors);
        let profile = made.and_then(|p| with_setup(p, self.setup)).map_err(|e| {
            let line = lines[element(&e).unwrap_or(0).min(lines.len() - 1)];
            anyhow::Error::new(e).context(self.place(line))
        })?;
        described.add(&profile, &first, missing, lines[0]);
        Ok((profile, lines))
    }

    fn patch(&self, patch: &FileRow) -> Result<optics_model::Result<MeasuredProfile>> {
        if self.rows.len() > 1 {
            bail!(
                "{}: x_mm is empty, which means a patch on the light base, but there are {} rows: a patch has one, and another thickness than a profile over the edge",
                self.place(patch.line),
                self.rows.len()
            );
        }
        let value =
            patch.value.with_context(|| format!("{}: the patch has no value", self.place(patch.line)))?;
        let std_error = patch.std_error.unwrap_or_default();
        let made = MeasuredProfile::patch(&self.channel, self.thickness_mm, value, std_error);
        Ok(made.and_then(|p| {
            let known =
                ProfileSetup { thickness_std_error_mm: self.setup.thickness_std_error_mm, ..*p.setup() };
            p.with_setup(known)
        }))
    }
}

/// The profile with its set-up.
fn with_setup(profile: MeasuredProfile, setup: ProfileSetup) -> optics_model::Result<MeasuredProfile> {
    let profile = profile.with_setup(setup)?;
    let x = profile.x_mm();
    let (first, last) = (x[0], x[x.len() - 1]);
    match setup.origin_mm {
        Some(origin) if !(first..=last).contains(&origin) => {
            let allowed =
                format!("the profile's x runs from {first} to {last} mm, and the edge must lie within");
            Err(Invalid::new("origin_mm", origin, allowed))
        }
        _ => Ok(profile),
    }
}

/// The position that every message about a profile reports.
pub(super) fn place_of(line: u64, material: &str, channel: &str, thickness_mm: f64) -> String {
    format!("line {line}, material {material}, channel {channel}, {thickness_mm} mm")
}

/// The index in the field of an error, such as 12 in `values[12]`.
fn element(invalid: &Invalid) -> Option<usize> {
    invalid.field().split_once('[')?.1.strip_suffix(']')?.parse().ok()
}
