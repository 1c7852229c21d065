//! Reads the files of a session's folder as inputs of a measurement, and adds the results to it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use farm_figures::estimates::estimate_rows;
use farm_figures::{error_budget, fit_figure, spectra_figure};
use optics_model::fit::{FitCurves, MaterialFit};
use optics_model::{Digest, Grid, Scene};
use serde::Deserialize;

use crate::capture::{CaptureReport, MeasureVerdict, Media, SESSION, Simulated, holds_photographs};
use crate::document::Block;
use crate::grid_file::read_grid_without_responses;
use crate::record::SessionRecord;
use crate::whole_file::write_whole;

/// The part of a session file about wavelengths.
#[derive(Debug, Clone, Default)]
pub struct SessionBands {
    /// Filters; none for red, green and blue.
    pub bands: Vec<BandWidth>,
    /// Red, green and blue by the camera's sensitivities.
    pub colours: BTreeMap<String, BandWidth>,
    pub samples: Vec<SlabLight>,
}

impl SessionBands {
    /// The entries of a session file that have a known form; others belong to other programs.
    pub fn known(session: &serde_json::Value) -> Self {
        let list = |field: &str| session[field].as_array().cloned().unwrap_or_default();
        let colours = session["colours"].as_object().cloned().unwrap_or_default().into_iter();
        Self {
            bands: list("bands").into_iter().filter_map(|band| serde_json::from_value(band).ok()).collect(),
            colours: colours
                .filter_map(|(name, band)| Some((name, serde_json::from_value(band).ok()?)))
                .collect(),
            samples: list("samples")
                .into_iter()
                .filter_map(|slab| serde_json::from_value(slab).ok())
                .collect(),
        }
    }
}

/// Wavelength of a band and its standard deviation.
#[derive(Debug, Clone, Copy, Deserialize)]
pub struct BandWidth {
    pub wavelength_nm: f64,
    pub std_dev_nm: f64,
}

/// The light that blue excites in a slab.
#[derive(Debug, Clone, Deserialize)]
pub struct SlabLight {
    pub material: String,
    /// Share of the light of each colour; none if no shot shows it.
    #[serde(default)]
    pub fluorescence: Option<BTreeMap<String, Excited>>,
}

/// A share of light with its standard error.
#[derive(Debug, Clone, Copy, Deserialize)]
pub struct Excited {
    pub value: f64,
    pub std_error: f64,
}

/// A folder that `capture` wrote.
#[derive(Debug)]
pub struct SessionFolder {
    path: PathBuf,
}

impl SessionFolder {
    /// Refuses a folder without measurements.
    pub fn open(path: &Path) -> Result<Self> {
        let folder = Self { path: path.to_owned() };
        if !folder.measurements().exists() {
            let here = path.display();
            let remedy = match (path.join(SESSION).exists(), holds_photographs(path)) {
                (true, _) => format!("`farmctl capture {here}/{SESSION} --measure` measures its photographs"),
                (_, true) => {
                    format!("`farmctl capture --new {here}` makes a session file of its photographs")
                }
                _ => "give a folder that `farmctl capture` wrote, or a measurement file".to_owned(),
            };
            bail!("{here} has no measurements.csv: {remedy}");
        }
        Ok(folder)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn measurements(&self) -> PathBuf {
        self.path.join("measurements.csv")
    }

    /// The session file, if there is one.
    pub fn session(&self) -> Option<PathBuf> {
        Some(self.path.join("session.json")).filter(|path| path.exists())
    }

    /// Name and grid of the dictionary for the session's set-up, without responses. It is for all boards and shared with
    /// other sessions, or for the session's own board if no such dictionary serves that. The name contains a digest of grid,
    /// scene, and the steps of the responses, so that other set-ups have other names.
    pub fn dictionary(&self) -> Result<(String, Grid)> {
        let own = read_grid_without_responses(&self.path.join("grid.toml"))?;
        let (kind, grid) = own.for_all_boards().map_or(("session", own), |shared| ("boards", shared));
        let digest = Digest::of_plan(&grid).to_string();
        Ok((format!("{kind}-{}", &digest[..12]), grid))
    }

    /// The scene of the session, with its board; `None` without a grid file.
    pub fn scene(&self) -> Result<Option<Scene>> {
        let path = self.path.join("grid.toml");
        let scene = || Ok(read_grid_without_responses(&path)?.scene().clone());
        path.exists().then(scene).transpose()
    }

    /// Wavelengths of the session's channels.
    pub fn bands(&self) -> Result<SessionBands> {
        let Some(path) = self.session() else { return Ok(SessionBands::default()) };
        let place = || format!("session file {}", path.display());
        let text = std::fs::read_to_string(&path).with_context(place)?;
        let session: serde_json::Value = serde_json::from_str(&text).with_context(place)?;
        Ok(SessionBands::known(&session))
    }

    /// Names of people, instruments and certificates.
    pub fn record(&self) -> Result<SessionRecord> {
        let Some(path) = self.session() else { return Ok(SessionRecord::default()) };
        let place = || format!("session file {}", path.display());
        let text = std::fs::read_to_string(&path).with_context(place)?;
        let mut session: serde_json::Value = serde_json::from_str(&text).with_context(place)?;
        match session["record"].take() {
            serde_json::Value::Null => Ok(SessionRecord::default()),
            record => Ok(serde_json::from_value::<SessionRecord>(record).with_context(place)?.checked()?),
        }
    }

    /// Renders the report with the fits. Returns its path; `None` if the folder has no data of a report.
    pub fn complete(&self, fits: &[MaterialFit], mu: f64, answer: ReportedAnswer) -> Result<Option<PathBuf>> {
        let data = self.path.join("report.json");
        let Ok(json) = std::fs::read(&data) else { return Ok(None) };
        let report: CaptureReport =
            serde_json::from_slice(&json).with_context(|| format!("report data {}", data.display()))?;
        let figures = fits.iter().map(|fit| Ok(fit_figure(fit)?.svg())).collect::<Result<Vec<_>>>()?;
        let spectra = spectra_figure(fits).map(|figure| figure.svg());
        let simulated = fits.iter().flat_map(|fit| simulated(fit, mu)).collect();
        let (estimates, budget) = (estimate_rows(fits), error_budget(fits));
        let page = report.page(Some(&Media {
            verdict: answer.verdict,
            numbers: answer.numbers,
            estimates,
            budget,
            spectra,
            figures,
            simulated,
        }));
        let path = self.path.join("report.html");
        write_whole(&path, page.as_bytes()).with_context(|| format!("writing {}", path.display()))?;
        Ok(Some(path))
    }
}

/// The answer of a fit.
#[derive(Debug, Default)]
pub struct ReportedAnswer {
    pub verdict: MeasureVerdict,
    /// Without estimates of the scene and budget.
    pub numbers: Vec<Block>,
}

/// Simulated profiles of a material for each slab; empty unless it has red, green and blue.
fn simulated(fit: &MaterialFit, mu: f64) -> Vec<Simulated> {
    let curves = |name: &str| fit.channels.iter().find(|c| c.channel == name).map(|c| c.curves.as_slice());
    let (Some(red), Some(green), Some(blue)) = (curves("R"), curves("G"), curves("B")) else {
        return Vec::new();
    };
    let values = |curves: &FitCurves| {
        let curve = curves.refined.as_ref().or(curves.candidates.first());
        curve.map(|curve| curve.values.iter().map(|v| v / mu).collect::<Vec<f64>>()).unwrap_or_default()
    };
    let slabs = red.iter().zip(green).zip(blue);
    let slab = |((r, g), b): ((&FitCurves, &FitCurves), &FitCurves)| Simulated {
        label: format!("{} {} mm", fit.material, r.thickness_mm),
        values: [values(r), values(g), values(b)],
    };
    slabs.map(slab).filter(|s| s.values.iter().all(|v| !v.is_empty())).collect()
}
