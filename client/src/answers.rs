//! Formats answers of the fit as text and as JSON.

mod bands;
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
mod tilt;
mod verdict;

use anyhow::Result;
use farm_lab::measurement_file::Note;
use farm_lab::session_folder::SessionFolder;
use optics_model::fit::MaterialFit;

pub(crate) use budget::budget_text;
pub(crate) use design::design_text;
pub(crate) use fits::{FitsReport, fits_text, neighbours, objective};
pub(crate) use found::{MeasureAnswer, OLDER, media_files};
pub(crate) use inks::inks_text;
pub(crate) use options::{MeasurementAnswer, SetUpJson, UsedOptions};
pub(crate) use scale::{common_text, scale_text};
pub(crate) use scene::low_scale;
pub(crate) use summary::{ChannelSummary, Remark, all_remarks};
pub(crate) use verdict::{medium_rows, verdict, verdict_text};

/// Notes on the bands of a session and on its camera, which the residuals of one channel do not show.
pub(crate) fn set_up_notes(fits: &[MaterialFit], folder: Option<&SessionFolder>) -> Result<Vec<Note>> {
    let bands = folder.map(SessionFolder::bands).transpose()?.unwrap_or_default();
    Ok(bands::notes(fits, &bands).into_iter().chain(tilt::tilt(fits)).collect())
}
