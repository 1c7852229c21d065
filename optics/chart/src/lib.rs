//! Media from charts: patches that are stacks of slabs, seen as one value or colour each. Radiative transfer in plane
//! layers predicts them, and what it leaves is the error of the model, found by cross-validation.
//!
//! [`fit`] answers; `unknowns` has what is estimated, with its priors, `forward` the values of patches and their slopes,
//! `camera` what a camera makes of them.
//!
//! `docs/glossary.md` explains the terms.

mod camera;
mod fit;
mod folds;
mod forward;
mod problem;
mod unknowns;

pub use camera::{ChartCamera, Matrix, delta_e_2000, difference, lab, linear_srgb};
pub use fit::{ChartFit, fit};
pub use folds::scattered;
pub use forward::PatchValues;
pub use unknowns::{ChartUnknowns, LOW_ABSORPTION, MediaPrior};

use optics_model::Scene;

/// A patch of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct StackPatch {
    /// Material and thickness in mm of each slab, from the top to the base.
    pub slabs: Vec<(usize, f64)>,
    /// Which of the chart's views it is seen in.
    pub view: usize,
    /// Which of the chart's bases it lies on.
    pub base: usize,
    /// Radiance factors of the channels, or linear sRGB of a camera; transmittances in a view without a base.
    pub values: Vec<f64>,
    /// Their standard errors; 0 where not known.
    pub std_errors: Vec<f64>,
    /// Photograph and place in it, each coordinate from −1 to 1.
    pub place: Option<(usize, [f64; 2])>,
}

/// A way to look at patches.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartView {
    /// Layers, light and sensor, without the channels.
    pub scene: Scene,
    /// Whether the light that passes is seen, without a base.
    pub transmitted: bool,
    /// Whether the mirrored light is left out, as far as faces are smooth: the rest is the sheen.
    pub has_sheen: bool,
}

/// Patches with what is known about them.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    pub materials: usize,
    pub channels: usize,
    pub views: Vec<ChartView>,
    /// Reflectance of each base by channel; None where it is not known.
    pub bases: Vec<Vec<Option<f64>>>,
    pub patches: Vec<StackPatch>,
    /// None where channels are seen as they are.
    pub camera: Option<ChartCamera>,
    /// Anisotropy of each material, which charts do not determine.
    pub g: Vec<f64>,
    /// Standard error of all thicknesses together, as a share.
    pub thickness: f64,
    /// Index of refraction and its standard error.
    pub ior: [f64; 2],
    /// Media of an earlier measurement; None without one.
    pub prior: Option<MediaPrior>,
    /// Whether the light of each photograph is estimated, from the places of patches.
    pub light: bool,
}

impl Chart {
    /// Width of the narrowest peak of a phase function.
    fn narrowest_peak(&self) -> f64 {
        self.g.iter().fold(1.0, |least: f64, g| least.min(1.0 - g.abs()))
    }

    /// Numbers of a residual of a patch.
    fn components(&self) -> usize {
        if self.camera.is_some() { 3 } else { self.channels }
    }

    /// Number of photographs that places name.
    fn photos(&self) -> usize {
        let photos = self.patches.iter().filter_map(|patch| Some(patch.place?.0 + 1));
        if self.light { photos.max().unwrap_or(0) } else { 0 }
    }
}
