//! Reads small tables of numbers as instruments and spreadsheets write them: with lines before the names of the columns,
//! any usual separator, decimal commas and missing numbers.

use anyhow::{Context, Result, anyhow, bail};

use crate::measurement_file::is_missing;

/// Most lines before the names.
const LONGEST_PREAMBLE: usize = 200;
/// Most rows.
const MOST_ROWS: usize = 100_000;

/// A table whose first column is of a known kind.
#[derive(Debug)]
pub(crate) struct NumberTable {
    /// Names of the columns.
    pub names: Vec<String>,
    pub rows: Vec<NumberRow>,
}

#[derive(Debug)]
pub(crate) struct NumberRow {
    pub line: usize,
    /// None where a number is missing.
    pub numbers: Vec<Option<f64>>,
}

impl NumberTable {
    /// The table below the first line whose first cell is a name of the first column; `needed` says what that is. Empty
    /// lines, and lines that begin with #, are left out.
    pub fn parse(text: &str, is_first: impl Fn(&str) -> bool, needed: &str) -> Result<Self> {
        let is_content = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with('#');
        let lines = || text.lines().zip(1..).filter(|(line, _)| is_content(line));
        let head = lines().take(LONGEST_PREAMBLE).find_map(|(line, at)| {
            let separators = [Some(';'), Some('\t'), Some(','), None];
            let names = separators.map(|separator| (separator, cells(line, separator)));
            let found = names.into_iter().find(|(_, names)| names.len() > 1 && is_first(&names[0]))?;
            Some((at, found))
        });
        let Some((head, (separator, mut names))) = head else {
            let first = lines().next().map_or("", |(line, _)| line.trim());
            bail!("the first line is {first:?}: {needed} are needed");
        };
        while names.last().is_some_and(String::is_empty) {
            names.pop();
        }
        let row = |(text, line): (&str, usize)| {
            let numbers = numbers(&cells(text, separator), &names, separator);
            Ok(NumberRow { line, numbers: numbers.map_err(|error| anyhow!("line {line}: {error}"))? })
        };
        let rows: Vec<NumberRow> =
            lines().skip_while(|(_, at)| *at <= head).map(row).collect::<Result<_>>()?;
        if rows.len() > MOST_ROWS {
            bail!("the table has {} rows, {MOST_ROWS} are allowed", rows.len());
        }
        Ok(Self { names, rows })
    }
}

/// The numbers of a row's cells.
fn numbers(cells: &[String], names: &[String], separator: Option<char>) -> Result<Vec<Option<f64>>> {
    if cells.len() < names.len() || cells[names.len()..].iter().any(|cell| !cell.is_empty()) {
        bail!("{} numbers where the names are {}", cells.len(), names.len());
    }
    let number = |(cell, name): (&String, &String)| {
        if is_missing(cell) {
            return Ok(None);
        }
        let plain = cell.replace('\u{2212}', "-");
        let plain = if separator == Some(',') { plain } else { plain.replace(',', ".") };
        let number = plain.trim_end_matches('%').trim_end().parse().ok().filter(|v: &f64| v.is_finite());
        number.map(Some).with_context(|| format!("{name} = {cell:?} is no number"))
    };
    cells.iter().zip(names).map(number).collect()
}

/// The cells of a line without quotes; None separates at blanks.
fn cells(line: &str, separator: Option<char>) -> Vec<String> {
    let plain = |cell: &str| cell.trim().trim_matches('"').trim().to_owned();
    match separator {
        Some(separator) => line.split(separator).map(plain).collect(),
        None => line.split_whitespace().map(plain).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<NumberTable> {
        NumberTable::parse(text, |name| name.starts_with("nm"), "nm and values")
    }

    /// Separators, decimal commas, lines before the names, quotes, missing numbers and empty columns at the end are read.
    #[test]
    fn tables_are_read_as_programs_write_them() {
        for text in [
            "nm,a\n400,0.5\n410,NA\n",
            "# a filter\nnm;a\n400;0,5\n\n410;\n",
            "Baseline\nmade by hand\nnm\ta\n400\t0.5\n410\t--\n",
            "nm a\n400 0,5\n410 nan\n",
            "\"nm\",\"a\",\n\"400\",\"0.5\",\n\"410\",\"\",\n",
            "nm;a\n400;50e-2\n410;<NA>\n",
        ] {
            let table = parsed(text).unwrap();
            let rows: Vec<_> = table.rows.into_iter().map(|row| row.numbers).collect();
            assert_eq!(rows, [[Some(400.0), Some(0.5)], [Some(410.0), None]], "{text}");
            assert_eq!(table.names, ["nm", "a"], "{text}");
        }
    }

    /// Errors have the line and the cell.
    #[test]
    fn wrong_tables_are_refused_with_their_line() {
        for (text, message) in [
            ("a,b\n1,2\n", "the first line is \"a,b\": nm and values are needed"),
            ("nm,a\n400,x\n", "line 2: a = \"x\" is no number"),
            ("nm,a\n400\n", "line 2: 1 numbers where the names are 2"),
            ("nm,a\n400,0,5\n", "line 2: 3 numbers where the names are 2"),
        ] {
            assert_eq!(format!("{:#}", parsed(text).unwrap_err()), message);
        }
    }
}
