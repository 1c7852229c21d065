//! Charts of printed stacks, and slabs under a spectrophotometer: reads them, fits their media with `optics_chart`, and
//! makes answer and media of the result.

mod answer;
mod color_db;
mod data;
mod file;
mod judged;
mod media;
mod notes;
mod patch;
mod printed;
mod problem;
mod settings;
mod table;

pub use answer::{ChartAnswer, judged_blocks, measured};
pub use data::ChartJson;
pub use file::{ChartFile, is_chart};
pub use judged::{JudgedChart, judged};
pub use notes::is_multiple;
pub use patch::{NamedPatch, PatchPlace, REST, stack_text};
pub use printed::{ChartDesign, PrintedPatch};
pub use problem::NAMED_BASES;
pub use settings::{ChartSettings, PatchGeometry, bare_print};

#[cfg(test)]
mod tests;
