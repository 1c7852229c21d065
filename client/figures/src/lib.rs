//! Figures for people: the paper's Figs. 6, 7 and 9 of answers as they are, Figs. 3 and 5 of plain data, as SVG or PNG.
//!
//! A figure function checks its data, lays panels out on a canvas in CSS pixels and gives a [`Picture`]. The same data
//! gives the same bytes. Values that are not finite are left out.

mod axis;
mod canvas;
mod changes;
#[cfg(test)]
mod checks;
mod color;
mod curve;
mod design;
mod edge;
mod fit;
mod frame;
mod head;
mod legend;
mod map;
pub mod misfit;
mod number;
pub mod numbers;
mod overview;
mod picture;
mod profile;
mod scale;
mod sheet;
#[cfg(any(test, feature = "testing"))]
#[expect(clippy::unwrap_used, reason = "data of tests; with the feature they are not compiled as a test")]
pub mod testing;
mod text;

pub use changes::{ChangesFigure, ChangesPanel, LabelledCurve, changes_figure};
pub use design::design_figure;
pub use edge::{EdgeCurve, edge_figure};
pub use fit::fit_figure;
pub use map::{map_figure, noise_figure};
pub use overview::{OverviewFigure, overview_figure};
pub use picture::Picture;
pub use profile::profile_figure;
pub use scale::scale_figure;
