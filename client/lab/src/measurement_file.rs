//! Reads and writes measurements as tidy CSV: `material,channel,thickness_mm,x_mm,value[,std_error]`, and columns for a
//! profile's set-up; lines beginning with # are comments. Charts of spectrophotometers are read as CGATS. Common
//! variants of the format are read with a note of each assumption; ambiguous files are refused.

pub(crate) mod cgats;
mod columns;
mod names;
mod note;
mod number;
mod pixels;
mod rows;
mod suspicions;
mod table;
mod text;
mod write;

use std::path::Path;

use crate::file_kind::or_other_kind;
use anyhow::{Context, Result};
use optics_model::Measurement;

pub use columns::names as column_names;
pub use names::normal;
pub use note::Note;
use number::Decimal;
pub(crate) use number::is_missing;
use rows::ProfileDraft;
pub use suspicions::beyond_limits;
use table::Table;
pub use text::plain;
pub use write::{MeasurementWriter, check_name};

/// The contents of a measurement file.
#[derive(Debug)]
pub struct MeasurementFile {
    /// One measurement per material, in the order of their first rows.
    pub materials: Vec<Measurement>,
    /// Assumptions made in reading, and suspicious data; empty for a sound file in the strict format.
    pub notes: Vec<Note>,
}

/// Reads and checks the measurements of a file. Errors name line, material, channel and thickness.
pub fn read_measurements(path: &Path) -> Result<MeasurementFile> {
    let place = || match path.to_str() {
        Some(text::STDIN) => "measurement of standard input".to_owned(),
        _ => format!("measurement {}", path.display()),
    };
    let bytes = text::read(path).with_context(place)?;
    read(&bytes).with_context(place)
}

/// Reads and checks the measurements of a file's bytes.
pub fn read(bytes: &[u8]) -> Result<MeasurementFile> {
    or_other_kind(parsed(bytes), bytes, "measurement")
}

fn parsed(bytes: &[u8]) -> Result<MeasurementFile> {
    let mut notes = Vec::new();
    let bytes = text::unpacked(bytes, &mut notes)?;
    let text = text::decode(&bytes, &mut notes)?;
    let is_cgats = cgats::is(&text);
    if !is_cgats {
        cgats::refuse_other_spectra(&text)?;
    }
    let mut drafts = if is_cgats { cgats::drafts(&text, &mut notes)? } else { of_table(&text, &mut notes)? };
    rows::name_colours(&mut drafts, &mut notes)?;
    rows::look_alike(&drafts, &mut notes);
    rows::sort(&mut drafts, &mut notes)?;
    let profiles = rows::profiles(drafts, &mut notes)?;
    suspicions::examine(&profiles, &mut notes)?;
    Ok(MeasurementFile { materials: profiles.materials, notes })
}

fn of_table(text: &str, notes: &mut Vec<Note>) -> Result<Vec<ProfileDraft>> {
    let table = Table::open(text, notes)?;
    let decimal = Decimal::of(&table, notes)?;
    let drafts = rows::drafts(&table, decimal, notes)?;
    let blank = table.blank_rows();
    if blank > 0 {
        notes.push(Note::new("BLANK_ROWS", format!("rows without any entry are left out ({blank})")));
    }
    Ok(drafts)
}

#[cfg(test)]
mod tests;
