//! What the tests of the whole system share: reference data with their origin, and statistics.

pub mod reference;
pub mod statistics;
