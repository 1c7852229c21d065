//! Writes the media of a measurement as files.

use std::path::Path;

use anyhow::{Context, Result};
use farm_lab::media_file::{MEDIA_FILE, MeasuredWith, MediaFile};
use optics_model::fit::Common;
use optics_model::{Digest, Grid};

use crate::answers::{MeasureAnswer, media_files};
use crate::output::write_whole;

pub(super) fn write(folder: &Path, found: &MeasureAnswer, media: &str) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    for (name, text) in media_files(&found.materials)? {
        write_whole(&folder.join(name), text.as_bytes()).context(name)?;
    }
    write_media(folder, media)
}

/// The text of the file with the media and their covariance.
pub(super) fn media(dictionary: &str, grid: &Grid, found: &MeasureAnswer) -> Result<String> {
    let Common { mu, mu_std_error, .. } = found.common;
    let with = MeasuredWith {
        dictionary,
        digest: Digest::of_grid(grid),
        scene: grid.scene(),
        mu: [mu, mu_std_error],
    };
    MediaFile::new(&found.materials, &found.shared_errors, &with).text()
}

pub(super) fn write_media(folder: &Path, text: &str) -> Result<()> {
    write_whole(&folder.join(MEDIA_FILE), text.as_bytes()).context(MEDIA_FILE)
}
