//! Draws the paper's Figs. 6, 7 and 9 from answers, and Figs. 3 and 5 from plain data, as SVG, PNG or PDF; and formats
//! the texts of tables that terminal, report and page share.
//!
//! A figure function checks its data, lays panels out on a canvas in CSS pixels and returns a [`Picture`]. Equal data
//! give equal bytes. Values that are not finite are left out.
//!
//! `docs/glossary.md` explains the terms.

mod budget;
mod changes;
mod chart;
#[cfg(test)]
mod checks;
mod design;
mod drawing;
mod edge;
pub mod estimates;
mod fit;
mod map;
pub mod misfit;
pub mod numbers;
mod overview;
mod profile;
mod scale;
mod spectra;
#[cfg(any(test, feature = "testing"))]
#[expect(clippy::unwrap_used, reason = "data of tests; with the feature they are not compiled as a test")]
pub mod testing;

pub use budget::{ChannelBudget, ErrorBudget, error_budget, source_name};
pub use changes::{ChangesFigure, ChangesPanel, LabelledCurve, changes_figure};
pub use chart::{ChartPoint, chart_figure};
pub use design::design_figure;
pub use drawing::picture::Picture;
pub use edge::{EdgeCurve, edge_figure, sfr_figure};
pub use fit::fit_figure;
pub use map::{map_figure, noise_figure};
pub use overview::{OverviewFigure, overview_figure};
pub use profile::{profile_figure, simulated_figure};
pub use scale::scale_figure;
pub use spectra::spectra_figure;
