//! Formats answers of the fit as text and as JSON.

mod bound;
mod budget;
mod design;
mod fits;
mod found;
mod inks;
mod likelihood;
mod misfit;
mod options;
mod remarks;
mod scale;
mod scene;
mod summary;
mod table;
#[cfg(test)]
mod tests;
mod verdict;

pub(crate) use budget::budget_text;
pub(crate) use design::design_text;
pub(crate) use fits::{FitsReport, fits_text, neighbours, objective};
pub(crate) use found::{MeasureAnswer, OLDER, media_files};
pub(crate) use inks::inks_text;
pub(crate) use options::{MeasurementAnswer, SetUpJson, UsedOptions};
pub(crate) use scale::{common_text, scale_text};
pub(crate) use scene::low_scale;
pub(crate) use summary::{ChannelSummary, NumberWithInterval, Remark, all_remarks};
pub(crate) use verdict::{medium_rows, verdict, verdict_text};
