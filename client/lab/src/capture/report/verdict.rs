//! The verdict on a measurement, which stands first in a report and last on the terminal.

use serde::Serialize;

use crate::document::{Block, Remark, ValueTable};

/// A measurement in words.
#[derive(Debug, Clone, Default, Serialize)]
pub struct MeasureVerdict {
    pub sentences: Vec<String>,
    pub precision: Vec<PrecisionRow>,
    /// Reasons why numbers may be wrong, each with the channels concerned.
    pub warnings: Vec<Remark>,
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
    pub fn blocks(&self) -> Vec<Block> {
        let mut blocks =
            vec![Block::Verdict(self.sentences.join(" ")), Block::Remarks(self.warnings.clone())];
        if !self.precision.is_empty() {
            let row = |row: &PrecisionRow| {
                std::iter::once(row.material.clone()).chain(row.half_widths.iter().cloned()).collect()
            };
            let head = "material | σ_s(1−g) | σ_a | σ_t | g";
            blocks.push(ValueTable::new(head, self.precision.iter().map(row)).cards().block());
            blocks.push(Block::aside(
                "Half-widths of the 95 % intervals: the median over channels (the greatest, where it is larger).",
            ));
        }
        let first = self.improve_first.as_ref();
        blocks.extend(first.map(|first| Block::paragraph(format!("To improve: {first}."))));
        blocks
    }
}
