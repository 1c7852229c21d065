//! Reads patches from tables of spectrophotometers in CGATS.17 (ISO 28178): one row for a patch, with a reflectance for
//! each wavelength.

use anyhow::{Context, Result, bail};

use super::names::normal;
use super::note::Note;
use super::pixels::FileRow;
use super::rows::ProfileDraft;

/// Standard error of a reflectance where the file has no `STD_ERROR`: the repeatability of common instruments.
const REPEATABILITY: f64 = 0.001;
/// Reflectances above this are per cent.
const GREATEST_FACTOR: f64 = 1.5;
/// Beginnings of the names of columns that continue with a wavelength in nm, longest first.
const SPECTRAL: [&str; 8] = ["SPECTRAL_NM", "SPECTRAL_", "SPECTRAL", "SPEC_", "NM_", "NM", "R_", "R"];
/// Wavelengths of such columns in nm.
const NM: std::ops::RangeInclusive<f64> = 200.0..=2500.0;

/// Whether a text is a CGATS table.
pub(super) fn is(text: &str) -> bool {
    text.lines().any(|line| line.trim() == "BEGIN_DATA_FORMAT")
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
    let greatest = table.greatest(&bands)?;
    let white = match table.number("SPECTRAL_NORM")? {
        Some(white) if white > 0.0 => white,
        Some(white) => bail!("SPECTRAL_NORM = {white} is not valid: allowed are numbers above 0"),
        None if greatest > GREATEST_FACTOR => 100.0,
        None => 1.0,
    };
    let of_file = [table.number("THICKNESS_MM")?, table.number("STD_ERROR")?];
    let columns = [table.column("THICKNESS_MM"), table.column("STD_ERROR")];
    let mut drafts = Vec::new();
    for row in &table.rows {
        let given = |which: usize| match columns[which] {
            Some(column) => row.number(&table.columns, column).map(Some),
            None => Ok(of_file[which]),
        };
        let thickness_mm = given(0)?.context(
            "the CGATS table has no thickness: add a column THICKNESS_MM, or a line such as THICKNESS_MM 2 before it",
        )?;
        let std_error = Some(given(1)?.unwrap_or(REPEATABILITY));
        for (column, nm) in &bands {
            let value = Some(row.number(&table.columns, *column)? / white);
            let patch = FileRow { line: row.line, x_mm: None, value, std_error };
            drafts.push(ProfileDraft::patch_of(
                &normal(&row.cells[name]),
                &nm.to_string(),
                thickness_mm,
                patch,
            ));
        }
    }
    notes.push(Note::new(
        "CGATS",
        described(&table, &bands, white, columns[1].is_some() || of_file[1].is_some()),
    ));
    Ok(drafts)
}

fn described(table: &CgatsTable, bands: &[(usize, f64)], white: f64, has_errors: bool) -> String {
    let errors = if has_errors { "" } else { ", standard errors assumed as 0.001" };
    let (first, last) = (bands[0].1, bands[bands.len() - 1].1);
    format!(
        "a CGATS table of {} patches, with reflectances at {} wavelengths from {first} to {last} nm, of {white} for white{errors}",
        table.rows.len(),
        bands.len()
    )
}

/// The wavelength of a column.
fn band((column, name): (usize, &String)) -> Option<(usize, f64)> {
    let name = name.to_ascii_uppercase();
    let name = name.strip_suffix("NM").unwrap_or(&name);
    let rest = SPECTRAL.iter().find_map(|start| name.strip_prefix(start)).unwrap_or(name);
    let nm: f64 = rest.parse().ok()?;
    NM.contains(&nm).then_some((column, nm))
}

/// A table, with the keywords before it.
struct CgatsTable {
    keywords: Vec<(String, String)>,
    columns: Vec<String>,
    rows: Vec<CgatsRow>,
}

struct CgatsRow {
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
            let cells = words(text);
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
        if section != Section::Keywords || table.rows.is_empty() || expected != table.rows.len() as f64 {
            bail!("the CGATS table is not complete: {} of {expected} rows are there", table.rows.len());
        }
        Ok(table)
    }

    fn add(&mut self, line: u64, cells: Vec<String>) -> Result<()> {
        if cells.len() != self.columns.len() {
            bail!(
                "line {line} has {} values, but the CGATS table has {} columns",
                cells.len(),
                self.columns.len()
            );
        }
        self.rows.push(CgatsRow { line, cells });
        Ok(())
    }

    fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    fn number(&self, keyword: &str) -> Result<Option<f64>> {
        let found = self.keywords.iter().find(|(name, _)| name == keyword);
        found.map(|(name, value)| number(value).with_context(|| name.clone())).transpose()
    }

    fn greatest(&self, bands: &[(usize, f64)]) -> Result<f64> {
        let mut greatest = f64::NEG_INFINITY;
        for row in &self.rows {
            for (column, _) in bands {
                greatest = greatest.max(row.number(&self.columns, *column)?);
            }
        }
        Ok(greatest)
    }
}

impl CgatsRow {
    fn number(&self, columns: &[String], column: usize) -> Result<f64> {
        number(&self.cells[column]).with_context(|| format!("line {}, {}", self.line, columns[column]))
    }
}

fn number(text: &str) -> Result<f64> {
    let value: Option<f64> = text.replace(',', ".").parse().ok();
    value.filter(|v| v.is_finite()).with_context(|| format!("{text:?} is not a number"))
}

/// The words of a line, without a comment; blanks within quotes are part of a word.
fn words(line: &str) -> Vec<String> {
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
