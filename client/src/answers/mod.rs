//! Answers of the fit as people and programs read them.

mod misfit;
mod options;
mod table;
mod text;

pub(crate) use misfit::misfit_short;
pub(crate) use options::UsedOptions;
pub(crate) use table::table_csv;
pub(crate) use text::{albedo, common_text, fits_text, neighbours, scale_text, significant};
