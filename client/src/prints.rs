//! Predicts how prints of measured media look, and compares media: for the verbs about prints, and for the page.

pub(crate) mod bases;
pub(crate) mod comparison;
pub(crate) mod errors;
pub(crate) mod geometry;
mod model_error;
pub(crate) mod prediction;
mod prepared;
pub(crate) mod set_up;
pub(crate) mod view;
