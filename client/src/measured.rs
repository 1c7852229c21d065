//! Writes the media of a measurement: as text, as files, and into the folder of a session with its report.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use farm_lab::document::Block;
use farm_lab::measurement_file::Note;
use farm_lab::media_file::MEDIA_FILE;
use farm_lab::record::SessionRecord;
use farm_lab::research_object::{ANSWER_FILE, ResearchObject};
use farm_lab::session_folder::{ReportedAnswer, SessionFolder};
use farm_lab::uncertainty::UNCERTAINTY_FILE;
use optics_model::Grid;
use optics_model::fit::{Common, MaterialFit, ScaleCurve, Unmixed};
use serde::Serialize;

use crate::answers::{
    FitsReport, MeasureAnswer, Remark, UsedOptions, common_blocks, fits_blocks, inks_blocks, low_scale,
    media_files, screen_blocks, verdict,
};
use crate::output::{envelope, now_unix_s, utc, write_whole};
use crate::slurm::shell_quoted;

/// Files of media, with their purpose.
const WRITTEN: &str = "table.csv, media.json (for `farmctl predict`), uncertainty.html (statement of uncertainty), \
                       answer.json (all of --json), and for renderers media.py, media.xml, media.pbrt, media_blender.py";

/// The answer.
pub(crate) fn blocks(found: &MeasureAnswer, report: &FitsReport) -> Vec<Block> {
    let mut blocks = common_blocks(&found.common);
    // It explains the misfits of the channels, which follow.
    let low = low_scale(&found.common, &found.materials).map(Remark::warning);
    blocks.push(Block::Remarks(low.into_iter().collect()));
    blocks.extend(fits_blocks(report));
    blocks.extend(found.unmixed.as_ref().map(inks_blocks).unwrap_or_default());
    blocks.extend(kept(found));
    blocks
}

/// The first screen, with the folder that has the media.
pub(crate) fn screen(found: &MeasureAnswer, folder: Option<&Path>) -> Vec<Block> {
    let mut blocks = screen_blocks(&found.common, &found.materials);
    let low = low_scale(&found.common, &found.materials).map(Remark::warning);
    blocks.push(Block::Remarks(low.into_iter().collect()));
    blocks.extend(found.unmixed.as_ref().map(inks_blocks).unwrap_or_default());
    let rest = "`measure -v` shows all quantities, the set-up, and the error budget";
    let next = folder.zip(found.materials.first()).map(|(folder, fit)| {
        let (shown, print) = (shell_quoted(&folder.display().to_string()), shell_quoted(&format!("{}:1", fit.material)));
        format!("written to {shown}: media.json, uncertainty.html, media for renderers; how 1 mm of it looks: `farmctl predict {shown} {print}`")
    });
    blocks.extend(next.into_iter().chain([rest.to_owned()]).map(Block::Aside));
    blocks.extend(kept(found));
    blocks
}

fn kept(found: &MeasureAnswer) -> Option<Block> {
    let id = found.kept.as_ref()?;
    Some(Block::Preformatted(format!("kept: `farmctl measurements show {id}`")))
}

/// The line about a folder with the media; `others` are further files, each followed by a comma.
pub(crate) fn written_to(folder: &Path, others: &str) -> Block {
    Block::Paragraph(format!("written to {}: {others}{WRITTEN}", folder.display()))
}

/// Writes media and report into the folder of a session. Returns the report's path; `None` if the folder has no data of a
/// report.
pub(crate) fn complete(
    folder: &SessionFolder,
    found: &MeasureAnswer,
    dictionary: (&str, &Grid),
    report: &FitsReport,
) -> Result<Option<PathBuf>> {
    let record = folder.record()?;
    write_renderers(folder.path(), found)?;
    write_media(folder.path(), found, dictionary, Some(&record))?;
    // The report has its own tables of the estimates.
    let numbers = blocks(found, &FitsReport { scene: false, ..report.clone() });
    let answer = ReportedAnswer { verdict: verdict(&found.materials), numbers };
    let report = folder.complete(&found.materials, found.common.mu, answer)?;
    describe(folder.path(), found, &record)?;
    Ok(report)
}

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
    record: Option<&SessionRecord>,
) -> Result<()> {
    let media = found.media_file(dictionary, grid).text()?;
    write_whole(&folder.join(MEDIA_FILE), media.as_bytes()).context(MEDIA_FILE)?;
    let page = found.uncertainty(dictionary, grid, record);
    write_whole(&folder.join(UNCERTAINTY_FILE), page.as_bytes()).context(UNCERTAINTY_FILE)
}

/// The answer as `--json` prints it.
pub(crate) fn data<'a>(
    options: UsedOptions<'a>,
    found: &'a MeasureAnswer,
    notes: &'a [Note],
) -> impl Serialize {
    #[derive(Serialize)]
    struct MeasureJson<'a> {
        #[serde(flatten)]
        options: UsedOptions<'a>,
        /// Null if every channel has a separate anisotropy.
        common_g: Option<f64>,
        common: &'a Common,
        /// Null if the scale factor was given or the likelihood was maximised.
        scale: Option<&'a ScaleCurve>,
        materials: &'a [MaterialFit],
        /// Assumptions made in reading the file, and suspicious data in it.
        notes: &'a [Note],
        #[serde(skip_serializing_if = "Option::is_none")]
        unmixed: Option<&'a Unmixed>,
        /// Id of the kept measurement.
        #[serde(skip_serializing_if = "Option::is_none")]
        kept: Option<&'a str>,
        #[serde(skip_serializing_if = "Option::is_none")]
        not_kept: Option<&'a str>,
    }
    MeasureJson {
        options,
        common_g: found.common.g,
        common: &found.common,
        scale: found.scale.as_ref(),
        materials: &found.materials,
        notes,
        unmixed: found.unmixed.as_ref(),
        kept: found.kept.as_deref(),
        not_kept: found.not_kept.as_deref(),
    }
}

/// Writes the answer as `--json` prints it.
pub(crate) fn write_answer(folder: &Path, data: &impl Serialize) -> Result<()> {
    let path = folder.join(ANSWER_FILE);
    let text = envelope("measure", data)? + "\n";
    write_whole(&path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
}

/// Describes the folder of a session for archives.
fn describe(folder: &Path, found: &MeasureAnswer, record: &SessionRecord) -> Result<()> {
    let materials: Vec<&str> = found.materials.iter().map(|fit| fit.material.as_str()).collect();
    let now = utc(now_unix_s().unsigned_abs() * 1000);
    let date = now.split('T').next().unwrap_or_default();
    ResearchObject { materials: &materials, record, date }.write(folder)
}
