//! Arguments for the size of figures.

use std::path::Path;

use clap::Args;
use optics_model::{Invalid, Result};

use crate::figure_files::{FigureSize, check_path};

/// Heading of the help.
pub(super) const FIGURES: &str = "Figures";

/// The size of the figures of --plot.
#[derive(Debug, Default, Clone, Args)]
pub(crate) struct FigureArgs {
    /// Width of figures in mm, such as 170 for a page; texts are scaled with it [default: 96 pixels per inch].
    #[arg(long, value_name = "MM", help_heading = FIGURES)]
    plot_width: Option<f64>,
    /// Pixels per inch of PNG [default: 192].
    #[arg(long, value_name = "N", help_heading = FIGURES)]
    plot_dpi: Option<f64>,
}

impl FigureArgs {
    /// Checks the path of --plot, if there is one, and the size, before any long work.
    pub(crate) fn check(&self, path: Option<&Path>) -> anyhow::Result<()> {
        self.size()?;
        path.map_or(Ok(()), check_path)
    }

    /// The checked size.
    pub(crate) fn size(&self) -> Result<FigureSize> {
        let within = |field: &str, value: Option<f64>, [low, high]: [f64; 2]| match value {
            Some(v) if !(low..=high).contains(&v) => {
                Err(Invalid::new(field, v, format!("allowed are {low} to {high}")))
            }
            _ => Ok(value),
        };
        Ok(FigureSize {
            width_mm: within("plot_width", self.plot_width, [20.0, 2000.0])?,
            dpi: within("plot_dpi", self.plot_dpi, [30.0, 2400.0])?.unwrap_or(FigureSize::default().dpi),
        })
    }
}
