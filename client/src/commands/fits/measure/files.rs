//! Writes the media of a measurement as files.

use std::path::Path;

use anyhow::{Context, Result};
use farm_lab::media_file::MEDIA_FILE;
use farm_lab::record::SessionRecord;
use farm_lab::research_object::ResearchObject;
use farm_lab::uncertainty::UNCERTAINTY_FILE;
use optics_model::Grid;

use crate::answers::{MeasureAnswer, media_files};
use crate::output::{now_unix_s, utc, write_whole};

/// Writes table and media for renderers.
pub(crate) fn write_renderers(folder: &Path, found: &MeasureAnswer) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    for (name, text) in media_files(&found.materials)? {
        write_whole(&folder.join(name), text.as_bytes()).context(name)?;
    }
    Ok(())
}

/// Writes the media with their covariance, and the statement of uncertainty.
pub(crate) fn write_media(
    folder: &Path,
    found: &MeasureAnswer,
    (dictionary, grid): (&str, &Grid),
    record: &SessionRecord,
) -> Result<()> {
    let media = found.media_file(dictionary, grid).text()?;
    write_whole(&folder.join(MEDIA_FILE), media.as_bytes()).context(MEDIA_FILE)?;
    let page = found.uncertainty(dictionary, grid, record);
    write_whole(&folder.join(UNCERTAINTY_FILE), page.as_bytes()).context(UNCERTAINTY_FILE)
}

/// Describes the folder of a session for archives.
pub(super) fn describe(folder: &Path, found: &MeasureAnswer, record: &SessionRecord) -> Result<()> {
    let materials: Vec<&str> = found.materials.iter().map(|fit| fit.material.as_str()).collect();
    let now = utc(now_unix_s().unsigned_abs() * 1000);
    let date = now.split('T').next().unwrap_or_default();
    ResearchObject { materials: &materials, record, date }.write(folder)
}
