//! Writes the media of a measurement as files.

use std::path::Path;

use anyhow::{Context, Result};
use farm_lab::media_file::MEDIA_FILE;
use farm_lab::record::SessionRecord;
use farm_lab::research_object::ResearchObject;
use farm_lab::uncertainty::UNCERTAINTY_FILE;

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

pub(super) fn write_uncertainty(folder: &Path, page: &str) -> Result<()> {
    write_whole(&folder.join(UNCERTAINTY_FILE), page.as_bytes()).context(UNCERTAINTY_FILE)
}

/// Describes the folder of a session for archives.
pub(super) fn describe(folder: &Path, found: &MeasureAnswer, record: &SessionRecord) -> Result<()> {
    let materials: Vec<&str> = found.materials.iter().map(|fit| fit.material.as_str()).collect();
    let now = utc(now_unix_s().unsigned_abs() * 1000);
    let date = now.split('T').next().unwrap_or_default();
    ResearchObject { materials: &materials, record, date }.write(folder)
}

pub(super) fn write_media(folder: &Path, text: &str) -> Result<()> {
    write_whole(&folder.join(MEDIA_FILE), text.as_bytes()).context(MEDIA_FILE)
}
