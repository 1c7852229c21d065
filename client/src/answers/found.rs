//! Checks the answer to a measurement, and formats its media as files.

use anyhow::{Context, Result};
use farm_lab::media_file::{MeasuredWith, MediaFile};
use farm_lab::record::SessionRecord;
use farm_lab::uncertainty::UncertaintyStatement;
use farm_proto::wire::MeasureResponse;
use optics_model::fit::{Common, MaterialFit, ScaleCurve, SharedErrors, Unmixed};

use optics_model::{Digest, Grid};

use super::table::table_csv;
use crate::renderers;

/// The error if an answer lacks required values.
pub(crate) const OLDER: &str =
    "the coordinator is too old: its answer lacks the values common to all channels; upgrade it";

/// A checked answer.
#[derive(Debug)]
pub(crate) struct MeasureAnswer {
    /// The paper's curve; `None` if the scale factor was given or the likelihood was maximised.
    pub(crate) scale: Option<ScaleCurve>,
    pub(crate) common: Common,
    pub(crate) materials: Vec<MaterialFit>,
    /// `None` if no mixtures were given.
    pub(crate) unmixed: Option<Unmixed>,
    /// None of an older coordinator.
    pub(crate) shared_errors: SharedErrors,
    /// The id under which it is kept; `None` if it is not.
    pub(crate) kept: Option<String>,
    /// The reason why it is not kept although it should be.
    pub(crate) not_kept: Option<String>,
}

impl TryFrom<MeasureResponse> for MeasureAnswer {
    type Error = anyhow::Error;

    fn try_from(answer: MeasureResponse) -> Result<Self, Self::Error> {
        Ok(Self {
            scale: answer.scale.map(ScaleCurve::try_from).transpose()?,
            common: answer.common.context(OLDER)?.try_into()?,
            materials: answer.materials.into_iter().map(MaterialFit::try_from).collect::<Result<_, _>>()?,
            unmixed: answer.unmixed.map(Unmixed::try_from).transpose()?,
            shared_errors: answer.shared_errors.unwrap_or_default().try_into()?,
            kept: Some(answer.kept_id).filter(|id| !id.is_empty()),
            not_kept: Some(answer.not_kept).filter(|why| !why.is_empty()),
        })
    }
}

impl MeasureAnswer {
    /// The media with their covariance.
    pub(crate) fn media_file(&self, dictionary: &str, grid: &Grid) -> MediaFile {
        let Common { mu, mu_std_error, .. } = self.common;
        let digest = Digest::of_grid(grid);
        let with = MeasuredWith { dictionary, digest, scene: grid.scene(), mu: [mu, mu_std_error] };
        MediaFile::new(&self.materials, &self.shared_errors, &with)
    }

    /// The statement of uncertainty as a page; `record` is that of a session of `capture`.
    pub(crate) fn uncertainty(
        &self,
        dictionary: &str,
        grid: &Grid,
        record: Option<&SessionRecord>,
    ) -> String {
        let digest = Digest::of_grid(grid).to_string();
        UncertaintyStatement {
            fits: &self.materials,
            shared_errors: &self.shared_errors,
            common: &self.common,
            record,
            dictionary,
            digest: &digest,
        }
        .page()
    }
}

/// Table and media for renderers, as files with their names.
pub(crate) fn media_files(fits: &[MaterialFit]) -> Result<[(&'static str, String); 5]> {
    Ok([
        ("table.csv", table_csv(fits)?),
        ("media.py", renderers::mitsuba_dict(fits)),
        ("media.xml", renderers::mitsuba_xml(fits)),
        ("media.pbrt", renderers::pbrt(fits)),
        ("media_blender.py", renderers::blender(fits)),
    ])
}
