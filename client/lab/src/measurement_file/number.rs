//! Determines the decimal sign of a file, and parses its numbers.

use anyhow::{Context, Result, bail};

use super::note::Note;
use super::table::Table;

/// The decimal sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Decimal {
    Point,
    Comma,
}

impl Decimal {
    /// Examines every number of a file. Commas are taken for decimal ones only if at least one cannot separate
    /// thousands.
    pub fn of(table: &Table, notes: &mut Vec<Note>) -> Result<Self> {
        let (mut point, mut comma): (Option<NumberCell>, Option<NumberCell>) = (None, None);
        let mut proven = false;
        for row in table.rows() {
            let (line, row) = row?;
            for column in table.columns.numbers() {
                let text = &row[column.place];
                if !text.contains(',') {
                    if point.is_none() && text.contains('.') {
                        point = Some(NumberCell { line, text: text.to_owned() });
                    }
                    continue;
                }
                if text.contains('.') || text.matches(',').count() > 1 {
                    bail!(
                        "line {line}: {text:?} seems to have commas between thousands: write numbers without them"
                    );
                }
                proven |= !like_thousands(text);
                if comma.is_none() {
                    comma = Some(NumberCell { line, text: text.to_owned() });
                }
            }
        }
        let Some(comma) = comma else { return Ok(Self::Point) };
        if let Some(point) = point {
            bail!(
                "line {} has {:?} and line {} has {:?}: with points and commas in one file it is ambiguous which are decimal; use one of them",
                comma.line,
                comma.text,
                point.line,
                point.text
            );
        }
        if !proven {
            bail!(
                "line {}: {:?} can be {} or {}; write it with a decimal point",
                comma.line,
                comma.text,
                comma.text.replace(',', "."),
                comma.text.replace(',', "")
            );
        }
        notes.push(Note::new(
            "DECIMAL_COMMA",
            format!(
                "commas in numbers are decimal: {:?} is read as {}",
                comma.text,
                comma.text.replace(',', ".")
            ),
        ));
        Ok(Self::Comma)
    }

    /// Parses a finite number.
    pub fn read(self, text: &str, name: &str) -> Result<f64> {
        // Some programs write the typographic minus sign.
        let plain = text.replace('\u{2212}', "-");
        let plain = if self == Self::Comma { plain.replace(',', ".") } else { plain };
        let value: f64 = plain.parse().ok().with_context(|| format!("{name} = {text:?} is not a number"))?;
        if !value.is_finite() {
            bail!("{name} = {value} is not a finite number");
        }
        Ok(value)
    }
}

/// Whether a cell denotes a missing number, in the words of common programs.
pub(crate) fn is_missing(text: &str) -> bool {
    ["", "nan", "-nan", "na", "n/a", "<na>", "#n/a", "null", "none", "--", "masked", "missing"]
        .iter()
        .any(|word| text.eq_ignore_ascii_case(word))
}

/// The text of a number, and its line.
struct NumberCell {
    line: u64,
    text: String,
}

/// Whether the comma of a number could separate thousands: in 1,234 and 12,345, but not in 0,123 or 1,23.
fn like_thousands(text: &str) -> bool {
    let Some((whole, rest)) = text.trim_start_matches(['-', '+', '\u{2212}']).split_once(',') else {
        return false;
    };
    let digits = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    (1..=3).contains(&whole.len())
        && !whole.starts_with('0')
        && rest.len() == 3
        && digits(whole)
        && digits(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Only numbers whose comma could separate thousands are doubtful.
    #[test]
    fn only_possible_thousands_are_doubtful() {
        for doubtful in ["1,234", "-4,986", "12,345", "+123,456"] {
            assert!(like_thousands(doubtful), "{doubtful}");
        }
        for clear in ["0,123", "1,23", "1,2345", "-0,986", "1,5e-3", ",123", "1234,567"] {
            assert!(!like_thousands(clear), "{clear}");
        }
    }

    /// Numbers are read with a point or a comma, and must be finite.
    #[test]
    fn decimal_points_and_commas_are_read() {
        assert_eq!(Decimal::Comma.read("\u{2212}4,986", "x_mm").unwrap(), -4.986);
        assert_eq!(Decimal::Point.read("1e-3", "value").unwrap(), 0.001);
        let refused = |text: &str| Decimal::Point.read(text, "value").unwrap_err().to_string();
        assert_eq!(refused("inf"), "value = inf is not a finite number");
        assert_eq!(refused("1,5"), "value = \"1,5\" is not a number");
    }
}
