//! The rows of a file and what separates their cells.

use anyhow::{Result, bail};

use super::columns::{Columns, understood};
use super::note::Note;

/// Most rows of one file.
const MOST_ROWS: usize = 5_000_000;

/// A file's text, with the places of its columns.
#[derive(Debug)]
pub(super) struct Table<'a> {
    /// From the header on.
    body: &'a str,
    /// Lines before the header.
    before: u64,
    separator: u8,
    width: usize,
    pub columns: Columns,
}

impl<'a> Table<'a> {
    pub fn open(text: &'a str, notes: &mut Vec<Note>) -> Result<Self> {
        if text.trim().is_empty() {
            bail!("the file is empty");
        }
        let (body, before, told) = header_of(text);
        let (separator, header) = match told {
            Some(separator) => (separator, first_row(body, separator)?),
            None => separator_of(body)?,
        };
        if separator != b',' {
            let name = if separator == b';' { "semicolons".to_owned() } else { "tabs".to_owned() };
            let name = if b";\t".contains(&separator) { name } else { format!("{:?}", separator as char) };
            notes.push(Note::new("SEPARATOR", format!("columns are separated by {name}, not by commas")));
        }
        let columns = Columns::find(&header, notes)?;
        Ok(Self { body, before, separator, width: header.len(), columns })
    }

    /// Rows below the header with their line numbers, all as long as the header; those without any entry are left
    /// out, see [`Self::blank_rows`].
    pub fn rows(&self) -> impl Iterator<Item = Result<(u64, csv::StringRecord)>> {
        let rows = reader(self.body, self.separator).into_records().skip(1).enumerate();
        rows.filter_map(|(count, row)| self.row(count, row).transpose())
    }

    fn row(
        &self,
        count: usize,
        row: csv::Result<csv::StringRecord>,
    ) -> Result<Option<(u64, csv::StringRecord)>> {
        let row = row?;
        if count == MOST_ROWS {
            bail!("more than {MOST_ROWS} rows");
        }
        if blank(&row) {
            return Ok(None);
        }
        let line = self.before + row.position().map_or(0, csv::Position::line);
        let surplus = row.iter().skip(self.width).any(|cell| !cell.is_empty());
        if row.len() < self.width || surplus {
            let advice = if self.separator == b',' && surplus {
                ": if its commas are decimal, separate the columns by semicolons"
            } else {
                ""
            };
            bail!("line {line} has {} entries where the header has {}{advice}", row.len(), self.width);
        }
        Ok(Some((line, row)))
    }

    /// How many rows have cells, but nothing in any of them.
    pub fn blank_rows(&self) -> usize {
        let rows = reader(self.body, self.separator).into_records();
        rows.filter(|row| row.as_ref().is_ok_and(blank)).count()
    }
}

fn blank(row: &csv::StringRecord) -> bool {
    row.iter().all(str::is_empty)
}

fn reader(text: &str, separator: u8) -> csv::Reader<&[u8]> {
    csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .delimiter(separator)
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes())
}

fn first_row(text: &str, separator: u8) -> Result<csv::StringRecord> {
    Ok(reader(text, separator).into_records().next().transpose()?.unwrap_or_default())
}

/// The text from the header on, the number of lines before it, and the separator if a line `sep=;` tells it.
fn header_of(text: &str) -> (&str, u64, Option<u8>) {
    let (mut start, mut lines, mut told) = (0, 0, None);
    for line in text.split_inclusive('\n') {
        let words = line.trim();
        let separator = words.strip_prefix("sep=").and_then(|s| match s.as_bytes() {
            [one] => Some(*one),
            // The tab has been trimmed.
            [] => Some(b'\t'),
            _ => None,
        });
        told = told.or(separator);
        let empty = words.chars().all(|c| ",;\t".contains(c));
        if !(empty || words.starts_with('#') || separator.is_some()) {
            break;
        }
        start += line.len();
        lines += 1;
    }
    (&text[start..], lines, told)
}

/// The separator that makes most of the header understood.
fn separator_of(body: &str) -> Result<(u8, csv::StringRecord)> {
    let mut best = (b',', first_row(body, b',')?);
    for separator in *b";\t" {
        let header = first_row(body, separator)?;
        if understood(&header) > understood(&best.1) {
            best = (separator, header);
        }
    }
    if understood(&best.1) == 0 && best.1.iter().filter(|cell| cell.parse::<f64>().is_ok()).count() >= 2 {
        bail!("the first line holds numbers, where a line with the columns' names is wanted");
    }
    Ok(best)
}
