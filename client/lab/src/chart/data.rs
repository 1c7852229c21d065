//! The answer about a chart as `farmctl --json` prints it.

use optics_chart::Matrix;
use optics_model::descent::DescentEnd;
use optics_model::fit::MaterialFit;
use serde::Serialize;

use super::judged::JudgedChart;
use crate::measurement_file::Note;

/// The answer as `--json` prints it.
#[derive(Debug, Serialize)]
pub struct ChartJson {
    pub patches: usize,
    pub materials: Vec<MaterialFit>,
    /// Differences of patches from what the other nine tenths of the chart say; null below 20 different stacks.
    pub held_out: Option<JudgedChart>,
    /// Sum of squares of the residuals over their errors, and the number of values.
    pub chi2: f64,
    pub values: usize,
    /// Linear sRGB of the camera from the radiance factors; null where channels are seen as they are.
    pub matrix: Option<Matrix>,
    pub sheen: ChartNumber,
    pub sample_ior: ChartNumber,
    pub bases: Vec<ChartBase>,
    pub light: Vec<ChartLight>,
    /// Covariance of the errors of predictions.
    pub model_error: Vec<Vec<f64>>,
    pub descent: DescentEnd,
    pub notes: Vec<Note>,
}

/// A number with its standard error.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ChartNumber {
    pub value: f64,
    pub std_error: f64,
}

/// The reflectance of a base that was estimated.
#[derive(Debug, Clone, Serialize)]
pub struct ChartBase {
    pub base: String,
    pub channel: String,
    #[serde(flatten)]
    pub rho: ChartNumber,
}

/// The light of a photograph.
#[derive(Debug, Clone, Serialize)]
pub struct ChartLight {
    pub photo: String,
    /// Greatest less least light over the patches, as a share of the mean.
    pub range: f64,
}
