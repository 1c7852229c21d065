//! From rows to profiles.

use anyhow::{Context, Result, bail};
use optics_model::measurement::{ProfileSetup, colour};
use optics_model::{Invalid, MeasuredProfile, Measurement};

use super::columns::{Column, SETUP};
use super::note::Note;
use super::number::Decimal;
use super::table::Table;

/// One profile while its rows are being read.
pub(super) struct Draft {
    material: String,
    channel: String,
    thickness_mm: f64,
    /// What is known of its set-up, in the order of [`SETUP`].
    setup: [Option<f64>; 5],
    rows: Vec<Row>,
}

struct Row {
    line: u64,
    /// None in the one row of a patch.
    x_mm: Option<f64>,
    value: f64,
    std_error: f64,
}

impl Row {
    /// Of a patch it does not matter.
    fn x(&self) -> f64 {
        self.x_mm.unwrap_or_default()
    }
}

/// Profiles of a file, ordered by material, and the line of each of their pixels.
pub(super) struct Profiles {
    pub materials: Vec<Measurement>,
    /// `[material][profile][pixel]`.
    pub lines: Vec<Vec<Vec<u64>>>,
}

/// All rows, sorted into profiles in the order of their first rows.
pub(super) fn drafts(table: &Table, decimal: Decimal) -> Result<Vec<Draft>> {
    let mut drafts: Vec<Draft> = Vec::new();
    for row in table.rows() {
        let (line, row) = row?;
        add(&mut drafts, line, &row, table, decimal).with_context(|| format!("line {line}"))?;
    }
    if drafts.is_empty() {
        bail!("no rows");
    }
    Ok(drafts)
}

fn add(
    drafts: &mut Vec<Draft>,
    line: u64,
    row: &csv::StringRecord,
    table: &Table,
    decimal: Decimal,
) -> Result<()> {
    let columns = &table.columns;
    let number = |c: Column| Ok::<_, anyhow::Error>(decimal.read(&row[c.place], c.name)? * c.factor);
    let (material, channel) = (&row[columns.material.place], &row[columns.channel.place]);
    let thickness_mm = number(columns.thickness)?;
    let entry = Row {
        line,
        x_mm: Some(columns.x).filter(|c| !row[c.place].is_empty()).map(number).transpose()?,
        value: number(columns.value)?,
        std_error: columns.std_error.map_or(Ok(0.0), number)?,
    };
    let mut setup = [None; 5];
    for (known, column) in setup.iter_mut().zip(columns.setup) {
        // A cell may be empty: of this profile it is not known.
        *known = column.filter(|c| !row[c.place].is_empty()).map(number).transpose()?;
    }
    let same = |d: &Draft| d.material == material && d.channel == channel && d.thickness_mm == thickness_mm;
    // Rows of a profile are mostly neighbours: the last is tried first.
    match drafts.iter().rposition(same) {
        Some(place) => {
            check_same(&drafts[place], setup)?;
            drafts[place].rows.push(entry);
        }
        None => drafts.push(Draft {
            material: material.to_owned(),
            channel: channel.to_owned(),
            thickness_mm,
            setup,
            rows: vec![entry],
        }),
    }
    Ok(())
}

/// A profile has one set-up.
fn check_same(draft: &Draft, setup: [Option<f64>; 5]) -> Result<()> {
    for ((name, here), before) in SETUP.into_iter().zip(setup).zip(draft.setup) {
        if here != before {
            let told = |v: Option<f64>| v.map_or("nothing".to_owned(), |v| v.to_string());
            let (here, before, line) = (told(here), told(before), draft.rows[0].line);
            bail!(
                "{name} = {here}, but line {line} of the same profile has {before}: it must be the same in all rows of a profile"
            );
        }
    }
    Ok(())
}

/// If all channels are colours, whatever their spelling, they become R, G and B.
pub(super) fn name_colours(drafts: &mut [Draft], notes: &mut Vec<Note>) -> Result<()> {
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
            let Draft { material, channel, thickness_mm, rows, .. } = &drafts[i];
            bail!(
                "line {}, material {material}, {thickness_mm} mm: channel {channel:?} means {name}, which is there under another spelling: are these two profiles or one?",
                rows[0].line
            );
        }
        if drafts[i].channel != name {
            let told = format!("{:?} is read as {name}", drafts[i].channel);
            if !renamed.contains(&told) {
                renamed.push(told);
            }
            name.clone_into(&mut drafts[i].channel);
        }
    }
    if !renamed.is_empty() {
        notes.push(Note::new("CHANNELS", format!("channels: {}", renamed.join(", "))));
    }
    Ok(())
}

/// Rows that do not rise in x are sorted.
pub(super) fn sort(drafts: &mut [Draft], notes: &mut Vec<Note>) -> Result<()> {
    let (mut falling, mut mixed) = (0, 0);
    // Patches are looked at when they are made.
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
    let mut told = Vec::new();
    if falling > 0 {
        told.push(format!("x falls along {}, read from the other end", profiles(falling)));
    }
    if mixed > 0 {
        told.push(format!("the rows of {} are not in the order of x and were sorted", profiles(mixed)));
    }
    if !told.is_empty() {
        notes.push(Note::new("ORDER_OF_X", told.join("; ")));
    }
    Ok(())
}

/// Checked profiles, grouped by material.
pub(super) fn profiles(drafts: Vec<Draft>, with_errors: bool) -> Result<Profiles> {
    type Group = (String, Vec<MeasuredProfile>, Vec<Vec<u64>>);
    let mut groups: Vec<Group> = Vec::new();
    for draft in drafts {
        let mut lines: Vec<u64> = draft.rows.iter().map(|r| r.line).collect();
        let made = made(&draft, with_errors)?;
        if let Ok(profile) = &made {
            // All pixels of a patch are of its one row.
            lines.resize(profile.values().len(), lines[0]);
        }
        let profile = made.map_err(|e| {
            let line = lines[element(&e).unwrap_or(0).min(lines.len() - 1)];
            let place = place_of(line, &draft.material, &draft.channel, draft.thickness_mm);
            anyhow::Error::new(e).context(place)
        })?;
        match groups.iter_mut().find(|(name, _, _)| *name == draft.material) {
            Some((_, profiles, all)) => {
                profiles.push(profile);
                all.push(lines);
            }
            None => groups.push((draft.material, vec![profile], vec![lines])),
        }
    }
    let mut found = Profiles { materials: Vec::new(), lines: Vec::new() };
    for (material, profiles, lines) in groups {
        let place = format!("material {material}");
        found.materials.push(Measurement::new(material, profiles).context(place)?);
        found.lines.push(lines);
    }
    Ok(found)
}

/// The profile of a draft, or what is wrong with its numbers; a patch if it has no x.
fn made(draft: &Draft, with_errors: bool) -> Result<optics_model::Result<MeasuredProfile>> {
    let Draft { channel, thickness_mm, rows, setup, .. } = draft;
    if let Some(patch) = rows.iter().find(|r| r.x_mm.is_none()) {
        if rows.len() > 1 {
            let place = place_of(patch.line, &draft.material, channel, *thickness_mm);
            bail!(
                "{place}: x_mm is empty, which means a patch on the light base, but there are {} rows: a patch has one, and another thickness than a profile over the edge",
                rows.len()
            );
        }
        let std_error = if with_errors { patch.std_error } else { 0.0 };
        let made = MeasuredProfile::patch(channel, *thickness_mm, patch.value, std_error);
        return Ok(made.and_then(|p| {
            let known = ProfileSetup { thickness_std_error_mm: setup[0], ..*p.setup() };
            p.with_setup(known)
        }));
    }
    let take = |f: fn(&Row) -> f64| rows.iter().map(f).collect::<Vec<f64>>();
    let (x, values) = (take(Row::x), take(|r| r.value));
    let errors = with_errors.then(|| take(|r| r.std_error));
    let made = MeasuredProfile::new(channel, *thickness_mm, x, values, errors);
    Ok(made.and_then(|p| with_setup(p, *setup)))
}

/// The profile with what is known of its set-up, in the order of [`SETUP`].
fn with_setup(profile: MeasuredProfile, setup: [Option<f64>; 5]) -> optics_model::Result<MeasuredProfile> {
    let [thickness_std_error_mm, origin_mm, origin_std_error_mm, blur_mm, blur_std_error_mm] = setup;
    let profile = profile.with_setup(ProfileSetup {
        thickness_std_error_mm,
        origin_mm,
        origin_std_error_mm,
        blur_mm,
        blur_std_error_mm,
    })?;
    let x = profile.x_mm();
    let (first, last) = (x[0], x[x.len() - 1]);
    match origin_mm {
        Some(origin) if !(first..=last).contains(&origin) => {
            let allowed =
                format!("the profile's x runs from {first} to {last} mm, and the edge must lie within");
            Err(Invalid::new("origin_mm", origin, allowed))
        }
        _ => Ok(profile),
    }
}

/// The place that every message about a profile names.
pub(super) fn place_of(line: u64, material: &str, channel: &str, thickness_mm: f64) -> String {
    format!("line {line}, material {material}, channel {channel}, {thickness_mm} mm")
}

/// The number in the field that is complained of, as in `values[12]`.
fn element(invalid: &Invalid) -> Option<usize> {
    invalid.field().split_once('[')?.1.strip_suffix(']')?.parse().ok()
}
