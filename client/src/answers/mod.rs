//! Answers of the fit as people and programs read them.

mod json;
mod text;

pub(crate) use json::{CandidateJson, MaterialJson, OptionsJson, ScaleJson};
pub(crate) use text::{albedo, details, neighbours, scale_text, significant, table_csv, table_one};
