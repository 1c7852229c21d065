//! Writes the media of a measurement as files.

use std::path::Path;

use anyhow::{Context, Result};
use farm_lab::media_file::{MEDIA_FILE, MeasuredWith, MediaFile};
use farm_lab::record::Record;
use farm_lab::research_object::ResearchObject;
use farm_lab::uncertainty::{UNCERTAINTY_FILE, UncertaintyStatement};
use optics_model::fit::Common;
use optics_model::{Digest, Grid};

use crate::answers::{MeasureAnswer, media_files};
use crate::output::{now_unix_s, utc, write_whole};

pub(super) fn write(folder: &Path, found: &MeasureAnswer, media: &str, uncertainty: &str) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    for (name, text) in media_files(&found.materials)? {
        write_whole(&folder.join(name), text.as_bytes()).context(name)?;
    }
    write_media(folder, media)?;
    write_uncertainty(folder, uncertainty)
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

/// The statement of uncertainty of a measurement.
pub(super) fn uncertainty(dictionary: &str, grid: &Grid, found: &MeasureAnswer, record: &Record) -> String {
    let digest = Digest::of_grid(grid).to_string();
    UncertaintyStatement {
        fits: &found.materials,
        shared_errors: &found.shared_errors,
        common: &found.common,
        record,
        dictionary,
        digest: &digest,
    }
    .page()
}

pub(super) fn write_uncertainty(folder: &Path, page: &str) -> Result<()> {
    write_whole(&folder.join(UNCERTAINTY_FILE), page.as_bytes()).context(UNCERTAINTY_FILE)
}

/// Describes the folder of a session for archives.
pub(super) fn describe(folder: &Path, found: &MeasureAnswer, record: &Record) -> Result<()> {
    let materials: Vec<&str> = found.materials.iter().map(|fit| fit.material.as_str()).collect();
    let now = utc(now_unix_s().unsigned_abs() * 1000);
    let date = now.split('T').next().unwrap_or_default();
    ResearchObject { materials: &materials, record, date }.write(folder)
}

pub(super) fn write_media(folder: &Path, text: &str) -> Result<()> {
    write_whole(&folder.join(MEDIA_FILE), text.as_bytes()).context(MEDIA_FILE)
}
