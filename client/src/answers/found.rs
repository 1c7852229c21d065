//! Checks the answer to a measurement, and writes its media as files.

use std::borrow::Cow;

use anyhow::{Context, Result};
use farm_lab::media_file::{MeasuredWith, MediaFile};
use farm_lab::record::SessionRecord;
use farm_lab::uncertainty::UncertaintyStatement;
use farm_proto::wire::MeasureResponse;
use optics_model::fit::{Common, MaterialFit, ScaleCurve, SharedErrors, Unmixed};
use optics_model::{Digest, Grid};

use super::remarks::remarks;
use super::summary::{Estimated, quantities};
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
        .document()
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

/// Columns of `table.csv`.
const COLUMNS: &str = "material,channel,sigma_t_per_mm,sigma_t_low,sigma_t_high,albedo,albedo_low,albedo_high,g,g_low,g_high,\
    error,resolved,grid_sigma_t_per_mm,grid_albedo,grid_g,grid_error,remarks,reduced_scattering_per_mm,reduced_scattering_low,\
    reduced_scattering_high,absorption_per_mm,absorption_low,absorption_high,misfit,chi2,degrees_of_freedom,probability,\
    resolved_at_g,second_lobe_weight,second_lobe_g";

/// The table as CSV: one row per refined channel.
pub(super) fn table_csv(fits: &[MaterialFit]) -> Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(COLUMNS.split(','))?;
    for (fit, channel) in fits.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c))) {
        let Some(r) = &channel.refined else { continue };
        let l = &r.likelihood;
        let [reduced_scattering, absorption, sigma_t, albedo, g] = quantities(r).map(with_ends);
        let remarks: Vec<String> = remarks(channel).into_iter().map(|(text, _)| text).collect();
        let lobe = r.second_lobe.map(|lobe| [lobe.weight(), lobe.g()].map(|v| v.to_string()));
        let mut row = vec![fit.material.clone(), channel.channel.clone()];
        row.extend([sigma_t, albedo, g].concat());
        row.extend([r.best.error.to_string(), r.resolved.to_string()]);
        // Media from charts have no record.
        let record = channel.candidates.first().map(|record| {
            let n = &record.medium;
            [n.sigma_t_per_mm(), n.albedo(), n.g(), record.error].map(|v| v.to_string())
        });
        row.extend(record.unwrap_or_default());
        row.push(remarks.join("; "));
        row.extend([reduced_scattering, absorption].concat());
        row.extend([r.misfit, l.chi2, l.degrees_of_freedom, l.probability].map(|v| v.to_string()));
        row.push(r.resolved_at_g.to_string());
        row.extend(lobe.unwrap_or_default());
        writer.write_record(row.iter().map(|cell| as_text(cell).into_owned()))?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

/// A value and the ends of its interval, empty where that is open.
fn with_ends((value, i): Estimated) -> [String; 3] {
    let end = |is_open: bool, end: f64| if is_open { String::new() } else { end.to_string() };
    [value.to_string(), end(i.open_low, i.low), end(i.open_high, i.high)]
}

/// A cell that spreadsheets show as text: one that begins like a formula and is no number would be evaluated there,
/// although its content is not trusted.
fn as_text(cell: &str) -> Cow<'_, str> {
    let is_formula = cell.starts_with(['=', '+', '-', '@', '\t', '\r']) && cell.parse::<f64>().is_err();
    if is_formula { format!("'{cell}").into() } else { cell.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Formulas of spreadsheets are quoted as text, and numbers are not.
    #[test]
    fn formulas_are_quoted_and_numbers_are_not() {
        for formula in ["=HYPERLINK(\"http://x\")", "+1+1", "-2+3", "@SUM(A1)", "\t=1"] {
            assert_eq!(as_text(formula), format!("'{formula}"));
        }
        for plain in ["", "white", "-0.5", "+1", "-inf", "1e-3", "a=b"] {
            assert_eq!(as_text(plain), plain);
        }
    }
}
