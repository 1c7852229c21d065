//! Answers of the fit as people and programs read them.

mod fits;
mod misfit;
mod numbers;
mod options;
mod remarks;
mod scale;
mod table;

pub(crate) use fits::{fits_text, neighbours};
pub(crate) use misfit::misfit_short;
pub(crate) use numbers::{albedo, significant};
pub(crate) use options::UsedOptions;
pub(crate) use scale::{common_text, scale_text};
pub(crate) use table::table_csv;
