//! Splits a file into rows and cells.

use anyhow::{Result, bail};

use super::columns::{ColumnField, Columns, understood};
use super::note::Note;

/// Largest number of rows of one file.
const MOST_ROWS: usize = 5_000_000;

/// Number of lines that are searched for a header.
const LONGEST_PREAMBLE: usize = 200;

/// A file's text with its recognised columns.
#[derive(Debug)]
pub(super) struct Table<'a> {
    /// The text from the header on, or from the first row if a comment is the header.
    body: &'a str,
    /// Number of lines before the body.
    before: u64,
    /// Number of rows of the body that are the header: one or none.
    header_rows: usize,
    separator: u8,
    width: usize,
    pub columns: Columns,
}

impl<'a> Table<'a> {
    pub fn open(text: &'a str, notes: &mut Vec<Note>) -> Result<Self> {
        if text.trim().is_empty() {
            bail!("the file is empty");
        }
        let (body, before, declared) = header_of(text);
        let (mut separator, mut header) = match declared {
            Some(separator) => (separator, first_row(body, separator)?),
            None => separator_of(body)?,
        };
        let mut header_rows = 1;
        if understood(&header) < ColumnField::NEEDED.len() {
            if let Some((line, commented)) = commented_header(&text[..text.len() - body.len()])? {
                let note = format!("the comment in line {line} is read as the columns' names");
                notes.push(Note::new("COMMENTED_HEADER", note));
                ((separator, header), header_rows) = (commented, 0);
            } else {
                refuse_preamble(body, before, &header)?;
            }
        }
        if separator != b',' {
            let name = match separator {
                b';' => "semicolons".to_owned(),
                b'\t' => "tabs".to_owned(),
                b' ' => "blanks".to_owned(),
                other => format!("{:?}", other as char),
            };
            notes.push(Note::new("SEPARATOR", format!("columns are separated by {name}, not by commas")));
        }
        let columns = Columns::find(&header, notes)?;
        notes.extend(commented_rows(body, before, separator, header.len()));
        Ok(Self { body, before, header_rows, separator, width: header.len(), columns })
    }

    /// Rows below the header with their line numbers, all as long as the header; those without any entry are left
    /// out, see [`Self::blank_rows`].
    pub fn rows(&self) -> impl Iterator<Item = Result<(u64, csv::StringRecord)>> {
        let rows = reader(self.body, self.separator).into_records().skip(self.header_rows).enumerate();
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

    /// Number of rows whose cells are all empty.
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

/// The text from the header on, the number of lines before it, and the separator if a line `sep=;` declares it.
fn header_of(text: &str) -> (&str, u64, Option<u8>) {
    let (mut start, mut lines, mut declared) = (0, 0, None);
    for line in text.split_inclusive('\n') {
        let words = line.trim();
        let separator = words.strip_prefix("sep=").and_then(|s| match s.as_bytes() {
            [one] => Some(*one),
            // The tab has been trimmed.
            [] => Some(b'\t'),
            _ => None,
        });
        declared = declared.or(separator);
        let empty = words.chars().all(|c| ",;\t".contains(c));
        if !(empty || words.starts_with('#') || separator.is_some()) {
            break;
        }
        start += line.len();
        lines += 1;
    }
    (&text[start..], lines, declared)
}

/// A note of comments that hold a whole row of the table, for example of a material called `#2`.
fn commented_rows(body: &str, before: u64, separator: u8, width: usize) -> Option<Note> {
    let is_row = |line: &str| {
        let cells: Vec<&str> = line.split(separator as char).collect();
        let numbers = cells.iter().filter(|cell| cell.trim().parse::<f64>().is_ok()).count();
        line.starts_with('#') && cells.len() == width && numbers >= 2
    };
    let mut rows = body.lines().zip(before + 1..).filter(|(line, _)| is_row(line));
    let (_, first) = rows.next()?;
    let text = format!(
        "{} lines that begin with # hold whole rows and are left out as comments, the first of them line {first}; if # \
         begins a material's name, put the name in quotes",
        1 + rows.count()
    );
    Some(Note::new("COMMENTED_ROWS", text))
}

/// The separator with which most names of the header are recognised.
fn separator_of(body: &str) -> Result<(u8, csv::StringRecord)> {
    let mut best = (b',', first_row(body, b',')?);
    for separator in *b";\t| " {
        let header = first_row(body, separator)?;
        if understood(&header) > understood(&best.1) {
            best = (separator, header);
        }
    }
    Ok(best)
}

/// The last comment that names the columns, as some programs write their header, with its line and separator.
fn commented_header(before: &str) -> Result<Option<(u64, (u8, csv::StringRecord))>> {
    for (text, line) in before.lines().zip(1..).collect::<Vec<_>>().into_iter().rev() {
        let Some(comment) = text.trim_start().strip_prefix('#') else { continue };
        let found = separator_of(comment.trim_start_matches('#').trim())?;
        if understood(&found.1) >= ColumnField::NEEDED.len() {
            return Ok(Some((line, found)));
        }
    }
    Ok(None)
}

/// Refuses a file whose header is further below, or is missing.
fn refuse_preamble(body: &str, before: u64, first: &csv::StringRecord) -> Result<()> {
    for (text, line) in body.lines().take(LONGEST_PREAMBLE).zip(before + 1..) {
        if separator_of(text).is_ok_and(|(_, header)| understood(&header) >= ColumnField::NEEDED.len()) {
            bail!(
                "line {} does not name the columns; line {line} seems to: delete the lines before it, or begin them with #",
                before + 1
            );
        }
    }
    if understood(first) == 0 && first.iter().filter(|cell| cell.parse::<f64>().is_ok()).count() >= 2 {
        bail!("the first line has numbers: add a line with the columns' names before it");
    }
    Ok(())
}
