//! Reads tabulated phase functions from CSV files.

use std::path::Path;

use anyhow::{Context, Result, bail};
use optics_model::phase::PhaseTable;

use crate::grid_file::read_text;
use crate::number_table::NumberTable;

/// Names of the columns.
const COLUMNS: [&str; 2] = ["angle_deg", "value"];

/// Reads a phase function: columns `angle_deg`, rising from 0 to 180, and `value` in any unit. Lines beginning with # are
/// comments.
pub fn read_phase_table(path: &Path) -> Result<PhaseTable> {
    let what = "phase function";
    phase_table(&read_text(path, what)?).with_context(|| format!("{what} {}", path.display()))
}

fn phase_table(text: &str) -> Result<PhaseTable> {
    let needed = format!("the columns {}", COLUMNS.join(","));
    let table = NumberTable::parse(text, |name| name == COLUMNS[0], &needed)?;
    if table.names != COLUMNS {
        bail!("the columns are {:?}: {needed} are needed", table.names.join(","));
    }
    let (mut angle_deg, mut value) = (Vec::new(), Vec::new());
    for row in &table.rows {
        let number = |i: usize| {
            row.numbers[i].with_context(|| format!("line {}: {} is missing", row.line, COLUMNS[i]))
        };
        angle_deg.push(number(0)?);
        value.push(number(1)?);
    }
    Ok(PhaseTable::new(angle_deg, value)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Comments and spaces are skipped.
    #[test]
    fn phase_tables_are_read() {
        let table = phase_table("# isotropic\nangle_deg, value\n0,1\n# middle\n90, 1\n180,1\n").unwrap();
        assert_eq!(table.angle_deg(), [0.0, 90.0, 180.0]);
        assert!(table.mean_cosine().abs() < 1e-12);
    }

    /// Errors have the line and the cell.
    #[test]
    fn wrong_phase_tables_are_refused() {
        for (text, message) in [
            (
                "angle,value\n0,1\n",
                "the first line is \"angle,value\": the columns angle_deg,value are needed",
            ),
            ("angle_deg,value\n0,1\n180,x\n", "line 3: value = \"x\" is no number"),
            (
                "angle_deg,value\n0,1\n170,1\n",
                "phase_function.angle_deg[1] = 170 is not valid: angles must rise from 0 to 180 degrees",
            ),
        ] {
            assert_eq!(phase_table(text).unwrap_err().to_string(), message);
        }
        assert!(phase_table("angle_deg,value\n0,1,2\n").is_err());
    }
}
