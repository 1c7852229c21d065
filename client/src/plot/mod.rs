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
mod files;
mod fit;
mod frame;
mod head;
mod legend;
mod map;
mod number;
mod overview;
mod picture;
mod profile;
mod scale;
mod sheet;
mod text;

pub(crate) use changes::{ChangesFigure, ChangesPanel, LabelledCurve, changes_figure};
pub(crate) use design::design_figure;
pub(crate) use files::{drawn, file_name, write_fits, write_maps};
pub(crate) use overview::{OverviewFigure, overview_figure};
pub(crate) use picture::Picture;
pub(crate) use profile::profile_figure;
pub(crate) use scale::scale_figure;

pub(crate) use fit::fit_figure;
pub(crate) use map::{map_figure, noise_figure};
