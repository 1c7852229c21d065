//! Answers of the fit as documents and as JSON.

mod bands;
mod design;
mod fits;
mod found;
mod inks;
mod likelihood;
mod options;
mod remarks;
mod scale;
mod screen;
mod summary;
#[cfg(test)]
mod tests;
mod tilt;
mod verdict;

use anyhow::Result;
use farm_lab::measurement_file::Note;
use farm_lab::session_folder::SessionFolder;
use optics_model::fit::MaterialFit;

pub(crate) use design::design_blocks;
pub(crate) use farm_lab::document::Remark;
pub(crate) use fits::{FitsReport, fits_blocks, neighbours, objective};
pub(crate) use found::{MeasureAnswer, OLDER, media_files};
pub(crate) use inks::inks_blocks;
pub(crate) use options::{MeasurementAnswer, SetUpJson, UsedOptions};
pub(crate) use remarks::all_remarks;
pub(crate) use scale::{common_blocks, common_text, low_scale, scale_blocks};
pub(crate) use screen::screen_blocks;
pub(crate) use summary::ChannelSummary;
pub(crate) use verdict::verdict;

/// Notes on the bands of a session and on its camera, which the residuals of one channel do not show.
pub(crate) fn set_up_notes(fits: &[MaterialFit], folder: Option<&SessionFolder>) -> Result<Vec<Note>> {
    let bands = folder.map(SessionFolder::bands).transpose()?.unwrap_or_default();
    Ok(bands::notes(fits, &bands).into_iter().chain(tilt::tilt(fits)).collect())
}
