//! Reads patches from tables of spectrophotometers in CGATS.17 (ISO 28178): one row for a patch, with a reflectance for
//! each wavelength.

use std::collections::HashMap;

use anyhow::{Context, Result, bail};

use super::names::normal;
use super::note::Note;
use super::pixels::FileRow;
use super::rows::ProfileDraft;

/// Standard error of a reflectance where the file has no `STD_ERROR`: the repeatability of common instruments.
const REPEATABILITY: f64 = 0.001;
/// Where no white is stated, reflectances above this are per cent: fluorescent papers have up to twice the light of a
/// white.
const GREATEST_FACTOR: f64 = 3.0;
/// Most that the brightest patch reflects of a white in the middle of its wavelengths.
const GREATEST_MEDIAN: f64 = 1.05;
/// Beginnings of the names of columns that continue with a wavelength in nm, without separators.
const SPECTRAL: [&str; 8] = ["", "SPECTRALNM", "SPECTRAL", "SPECNM", "SPEC", "NM", "R", "REFLECTANCE"];
/// Most sets of a table: those of the largest charts are a tenth of it.
const MOST_SETS: usize = 50_000;
/// Wavelengths of such columns in nm.
const NM: std::ops::RangeInclusive<f64> = 200.0..=2500.0;

/// Whether a text is a CGATS table.
pub(super) fn is(text: &str) -> bool {
    text.lines().any(|line| line.trim().trim_matches('"') == "BEGIN_DATA_FORMAT")
}

/// Refuses a table of spectra without the keywords of CGATS, as some programs write it by default.
pub(super) fn refuse_other_spectra(text: &str) -> Result<()> {
    // Numbers of a table may look like wavelengths.
    let is_named = |name: &&String| name.starts_with(char::is_alphabetic) && band((0, name)).is_some();
    let is_head = |line: &str| words(line).iter().filter(is_named).count() >= 5;
    if text.lines().take(100).any(|line| is_head(&line.replace([',', ';'], " "))) {
        bail!("this is a table of spectra without the keywords of CGATS: export it as CGATS (ISO 28178)");
    }
    Ok(())
}

/// The patches of a table, one for each row and wavelength.
pub(super) fn drafts(text: &str, notes: &mut Vec<Note>) -> Result<Vec<ProfileDraft>> {
    let table = CgatsTable::read(text)?;
    let names = ["SAMPLE_NAME", "SAMPLE_ID", "SampleID"];
    let name = names.iter().find_map(|name| table.column(name));
    let name = name.context("the CGATS table has no column SAMPLE_NAME or SAMPLE_ID")?;
    let bands: Vec<(usize, f64)> = table.columns.iter().enumerate().filter_map(band).collect();
    if bands.is_empty() {
        bail!(
            "the CGATS table has no reflectances: columns such as SPECTRAL_NM460, SPEC_460 or NM_460 are needed"
        );
    }
    table.refuse_other_quantities()?;
    let white = table.white(&bands)?;
    let of_file = [table.number("THICKNESS_MM")?, table.number("STD_ERROR")?];
    let columns = [table.column("THICKNESS_MM"), table.column("STD_ERROR")];
    let (mut patches, mut places) = (Vec::<MeasuredPatch>::new(), HashMap::new());
    for row in &table.rows {
        let given = |which: usize| match columns[which] {
            Some(column) => row.number(&table.columns, column).map(Some),
            None => Ok(of_file[which]),
        };
        let thickness_mm = given(0)?.context(
            "the CGATS table has no thickness: add a column THICKNESS_MM, or a line such as THICKNESS_MM 2 before it",
        )?;
        let value = |(column, _): &(usize, f64)| Ok(row.number(&table.columns, *column)? / white);
        let reading = PatchReading {
            values: bands.iter().map(value).collect::<Result<_>>()?,
            std_error: given(1)?.unwrap_or(REPEATABILITY),
        };
        let name = normal(&row.cells[name]).into_owned();
        let place = *places.entry((name.clone(), thickness_mm.to_bits())).or_insert(patches.len());
        if place == patches.len() {
            patches.push(MeasuredPatch { name, thickness_mm, line: row.line, readings: Vec::new() });
        }
        patches[place].readings.push(reading);
    }
    let has_errors = columns[1].is_some() || of_file[1].is_some();
    notes.push(Note::new("CGATS", described(&table, &patches, &bands, white, has_errors)));
    let draft = |patch: &MeasuredPatch, i: usize| {
        let (value, std_error) = patch.mean(i);
        let row = FileRow { line: patch.line, x_mm: None, value: Some(value), std_error: Some(std_error) };
        ProfileDraft::patch_of(&patch.name, &bands[i].1.to_string(), patch.thickness_mm, row)
    };
    Ok(patches.iter().flat_map(|patch| (0..bands.len()).map(move |i| draft(patch, i))).collect())
}

/// A chart of stacks as a CGATS table.
pub(crate) struct CgatsStacks {
    /// Wavelengths in nm; empty if the values are CIELAB.
    pub channels: Vec<String>,
    /// The words of each stack, its values, and their standard error.
    pub rows: Vec<(String, Vec<f64>, f64)>,
}

/// Whether a text is a CGATS table with a column `SLABS`.
pub(crate) fn has_stacks(text: &str) -> bool {
    is(text) && text.lines().any(|line| words(line).iter().any(|word| word == "SLABS"))
}

/// The stacks of a table with a column `SLABS`, with reflectances by wavelength or `LAB_L`, `LAB_A`, `LAB_B`.
pub(crate) fn stacks(text: &str) -> Result<CgatsStacks> {
    let table = CgatsTable::read(text)?;
    table.refuse_other_quantities()?;
    let slabs = table.column("SLABS").context("the CGATS table has no column SLABS")?;
    let bands: Vec<(usize, f64)> = table.columns.iter().enumerate().filter_map(band).collect();
    let lab = ["LAB_L", "LAB_A", "LAB_B"].map(|name| table.column(name));
    let (columns, white): (Vec<usize>, f64) = match lab {
        _ if !bands.is_empty() => (bands.iter().map(|(column, _)| *column).collect(), table.white(&bands)?),
        [Some(l), Some(a), Some(b)] => (vec![l, a, b], 1.0),
        _ => bail!("the CGATS table has neither reflectances by wavelength nor LAB_L, LAB_A and LAB_B"),
    };
    let error = table.number("STD_ERROR")?.unwrap_or(if bands.is_empty() { 0.0 } else { REPEATABILITY });
    let row = |row: &CgatsRow| {
        let value = |column: &usize| Ok(row.number(&table.columns, *column)? / white);
        let values = columns.iter().map(value).collect::<Result<_>>()?;
        Ok((normal(&row.cells[slabs]).into_owned(), values, error))
    };
    let channels = bands.iter().map(|(_, nm)| nm.to_string()).collect();
    Ok(CgatsStacks { channels, rows: table.rows.iter().map(row).collect::<Result<_>>()? })
}

/// A patch with all of its readings.
struct MeasuredPatch {
    name: String,
    thickness_mm: f64,
    /// Line of its first reading.
    line: u64,
    readings: Vec<PatchReading>,
}

struct PatchReading {
    /// Reflectances, one for each wavelength.
    values: Vec<f64>,
    std_error: f64,
}

impl MeasuredPatch {
    /// The mean of the readings at a wavelength, with its standard error: that of the readings, or of their scatter if
    /// that is larger.
    fn mean(&self, wavelength: usize) -> (f64, f64) {
        let n = self.readings.len() as f64;
        let values = || self.readings.iter().map(|reading| reading.values[wavelength]);
        let mean = values().sum::<f64>() / n;
        let stated = self.readings.iter().map(|reading| reading.std_error.powi(2)).sum::<f64>() / n;
        let scatter = values().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        (mean, (stated.max(scatter) / n).sqrt())
    }
}

fn described(
    table: &CgatsTable,
    patches: &[MeasuredPatch],
    bands: &[(usize, f64)],
    white: f64,
    has_errors: bool,
) -> String {
    let errors = if has_errors { "" } else { ", standard errors assumed as 0.001" };
    let repeated = match table.rows.len() - patches.len() {
        0 => String::new(),
        _ => format!(" ({} readings, whose means are taken)", table.rows.len()),
    };
    let (first, last) = (bands[0].1, bands[bands.len() - 1].1);
    format!(
        "a CGATS table of {} patches{repeated}, with reflectances at {} wavelengths from {first} to {last} nm, of {white} \
         for white{errors}",
        patches.len(),
        bands.len()
    )
}

/// The wavelength of a column.
fn band((column, name): (usize, &String)) -> Option<(usize, f64)> {
    let name = name.to_ascii_uppercase();
    let name = name.strip_suffix("NM").unwrap_or(&name);
    let start = name.find(|c: char| c.is_ascii_digit())?;
    let letters = name[..start].replace(['_', ' ', '-', '.'], "");
    let nm: f64 = name[start..].parse().ok()?;
    (SPECTRAL.contains(&letters.as_str()) && NM.contains(&nm)).then_some((column, nm))
}

/// A table, with the keywords before it.
struct CgatsTable {
    keywords: Vec<(String, String)>,
    columns: Vec<String>,
    rows: Vec<CgatsRow>,
}

/// A set of values.
struct CgatsRow {
    /// Its first line.
    line: u64,
    cells: Vec<String>,
}

/// The part of a file that a line belongs to.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Section {
    Keywords,
    Format,
    Data,
}

impl CgatsTable {
    fn read(text: &str) -> Result<Self> {
        let mut table = Self { keywords: Vec::new(), columns: Vec::new(), rows: Vec::new() };
        let mut section = Section::Keywords;
        for (line, text) in (1..).zip(text.lines()) {
            let cells = if section == Section::Data { table.cells(text) } else { words(text) };
            let Some(first) = cells.first() else { continue };
            section = match (first.as_str(), section) {
                ("BEGIN_DATA_FORMAT", Section::Keywords) if table.rows.is_empty() => Section::Format,
                ("BEGIN_DATA", Section::Keywords) if table.rows.is_empty() => Section::Data,
                ("BEGIN_DATA_FORMAT" | "BEGIN_DATA", _) => {
                    bail!("line {line}: a second CGATS table begins: write one table to a file")
                }
                ("END_DATA_FORMAT", Section::Format) | ("END_DATA", Section::Data) => Section::Keywords,
                (_, Section::Format) => {
                    table.columns.extend(cells);
                    section
                }
                (_, Section::Data) => {
                    table.add(line, cells)?;
                    section
                }
                (_, Section::Keywords) => {
                    let value = cells.get(1).cloned().unwrap_or_default();
                    table.keywords.push((first.clone(), value));
                    section
                }
            };
        }
        let expected = table.number("NUMBER_OF_SETS")?.unwrap_or(table.rows.len() as f64);
        let is_whole = |row: &CgatsRow| row.cells.len() == table.columns.len();
        if let Some(row) = table.rows.last().filter(|row| !is_whole(row)) {
            bail!("{}", row.too_long_or_short(table.columns.len()));
        }
        if section != Section::Keywords || table.rows.is_empty() || expected != table.rows.len() as f64 {
            bail!("the CGATS table is not complete: {} of {expected} rows are there", table.rows.len());
        }
        Ok(table)
    }

    /// The values of a line: between tabs where these give as many as the table has columns, else between blanks.
    fn cells(&self, line: &str) -> Vec<String> {
        let between_tabs = line.trim_end().split('\t').map(|cell| cell.trim().trim_matches('"').to_owned());
        let between_tabs: Vec<String> = between_tabs.collect();
        if between_tabs.len() == self.columns.len() { between_tabs } else { words(line) }
    }

    /// Adds the values of a line to the last set if that is not complete: sets may have several lines.
    fn add(&mut self, line: u64, cells: Vec<String>) -> Result<()> {
        let columns = self.columns.len();
        if self.rows.last().is_none_or(|row| row.cells.len() >= columns) {
            if self.rows.len() == MOST_SETS {
                bail!("line {line}: the CGATS table has more than {MOST_SETS} sets");
            }
            self.rows.push(CgatsRow { line, cells: Vec::new() });
        }
        let Some(row) = self.rows.last_mut() else { return Ok(()) };
        row.cells.extend(cells);
        if row.cells.len() > columns {
            bail!("{}", row.too_long_or_short(columns));
        }
        Ok(())
    }

    fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    fn number(&self, keyword: &str) -> Result<Option<f64>> {
        let found = self.keywords.iter().find(|(name, _)| name == keyword);
        found.map(|(name, value)| number(value).with_context(|| name.clone())).transpose()
    }

    /// Refuses transmittances, densities and the like, if the table says what it holds.
    fn refuse_other_quantities(&self) -> Result<()> {
        let other = |(_, value): &&(String, String)| {
            let value = value.to_ascii_uppercase();
            ["TRANSMI", "ABSORB", "EMISSI"].iter().any(|quantity| value.starts_with(quantity))
        };
        let kinds = ["QUANTITY", "MEASUREMENT_MODE", "MEASUREMENT_TYPE"];
        let mut stated = self.keywords.iter().filter(|(name, _)| kinds.contains(&name.as_str()));
        match stated.find(other) {
            Some((name, value)) => bail!("{name} is {value:?}: reflectances are needed"),
            None => Ok(()),
        }
    }

    /// The number for a perfect white: that of `SPECTRAL_NORM`, or 1 or 100 by all values.
    fn white(&self, bands: &[(usize, f64)]) -> Result<f64> {
        match self.number("SPECTRAL_NORM")? {
            Some(white) if white > 0.0 => return Ok(white),
            Some(white) => bail!("SPECTRAL_NORM = {white} is not valid: allowed are numbers above 0"),
            None => {}
        }
        let (mut greatest, mut brightest) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for row in &self.rows {
            let values = bands.iter().map(|(column, _)| row.number(&self.columns, *column));
            let mut values: Vec<f64> = values.collect::<Result<_>>()?;
            values.sort_by(f64::total_cmp);
            greatest = greatest.max(values[values.len() - 1]);
            brightest = brightest.max(values[values.len() / 2]);
        }
        match () {
            () if greatest > GREATEST_FACTOR => Ok(100.0),
            () if brightest <= GREATEST_MEDIAN => Ok(1.0),
            () => bail!(
                "the brightest patch reflects {brightest}: per cent of a dark print, or of 1 for white? Add the line \
                 SPECTRAL_NORM 100 or SPECTRAL_NORM 1"
            ),
        }
    }
}

impl CgatsRow {
    fn too_long_or_short(&self, columns: usize) -> String {
        let (line, values) = (self.line, self.cells.len());
        format!("the set of line {line} has {values} values, but the CGATS table has {columns} columns")
    }

    fn number(&self, columns: &[String], column: usize) -> Result<f64> {
        number(&self.cells[column]).with_context(|| format!("line {}, {}", self.line, columns[column]))
    }
}

fn number(text: &str) -> Result<f64> {
    let value: Option<f64> = text.replace(',', ".").parse().ok();
    value.filter(|v| v.is_finite()).with_context(|| format!("{text:?} is not a number"))
}

/// The words of a line, without a comment; blanks within quotes are part of a word. Spreadsheets put lines with quotes into
/// quotes.
fn words(line: &str) -> Vec<String> {
    let line = line.trim();
    let inner = line.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
    match inner.filter(|inner| inner.contains("\"\"") && !inner.replace("\"\"", "").contains('"')) {
        Some(quoted) => plain_words(&quoted.replace("\"\"", "\"")),
        None => plain_words(line),
    }
}

fn plain_words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quoted, mut begun) = (Vec::new(), String::new(), false, false);
    for c in line.chars() {
        match c {
            '"' => (quoted, begun) = (!quoted, true),
            '#' if !quoted && !begun => break,
            c if c.is_whitespace() && !quoted => {
                if std::mem::take(&mut begun) {
                    words.push(std::mem::take(&mut word));
                }
            }
            c => {
                word.push(c);
                begun = true;
            }
        }
    }
    if begun {
        words.push(word);
    }
    words
}
