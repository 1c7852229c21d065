//! Renders the verdict on a measurement, which stands first in a report.

use serde::Serialize;

use super::warning_list;
use crate::page::{cards, escaped};

/// A measurement in words.
#[derive(Debug, Clone, Default, Serialize)]
pub struct MeasureVerdict {
    pub sentences: Vec<String>,
    pub precision: Vec<PrecisionRow>,
    /// Reasons why numbers may be wrong, each with the channels concerned.
    pub warnings: Vec<String>,
    /// The source of error with the largest share, and its remedy.
    pub improve_first: Option<String>,
}

/// How well a material is known.
#[derive(Debug, Clone, Serialize)]
pub struct PrecisionRow {
    pub material: String,
    /// Half-widths of the 95 % intervals of σ_s(1 − g), σ_a, σ_t and g: the median over channels, and the greatest.
    pub half_widths: [String; 4],
}

impl MeasureVerdict {
    /// Names of the columns of [`PrecisionRow`].
    pub const COLUMNS: [&'static str; 5] = ["material", "σ_s(1−g)", "σ_a", "σ_t", "g"];

    pub(super) fn section(&self) -> String {
        let warnings: Vec<&str> = self.warnings.iter().map(String::as_str).collect();
        let rows: Vec<Vec<String>> = self.precision.iter().map(PrecisionRow::cells).collect();
        let precision = if rows.is_empty() {
            String::new()
        } else {
            let note = "Half-widths of the 95 % intervals: the median over channels (the greatest, where it is larger).";
            format!("{}<p class=\"faint\">{note}</p>\n", cards(&Self::COLUMNS, &rows))
        };
        let first = self.improve_first.as_ref();
        let first = first.map(|first| format!("<p>To improve first: {}.</p>\n", escaped(first)));
        format!(
            "<p><strong>{}</strong></p>\n{}{precision}{}",
            escaped(&self.sentences.join(" ")),
            warning_list(&warnings),
            first.unwrap_or_default()
        )
    }
}

impl PrecisionRow {
    pub fn cells(&self) -> Vec<String> {
        std::iter::once(self.material.clone()).chain(self.half_widths.iter().cloned()).collect()
    }
}
