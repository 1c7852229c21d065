//! Commands that make, simulate and check measurements.

pub(crate) mod capture;
pub(crate) mod check;
pub(crate) mod simulate;
