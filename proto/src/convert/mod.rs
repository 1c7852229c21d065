//! Wire ↔ domain, once. Everything that comes in passes a validating constructor; everything that
//! goes out is a plain `From`.

mod fit;
mod lease;
mod measurement;
mod model;
mod scale;
mod status;

use crate::invalid::{Invalid, Result};

/// A message field that must be there.
fn required<T>(field: &str, value: Option<T>) -> Result<T> {
    value.ok_or_else(|| Invalid::new(field, "nothing", "a value is needed"))
}
