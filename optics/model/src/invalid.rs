//! The one error for values that break a rule of the domain.

use std::fmt;

/// A value out of its range: the field, the given value and the allowed ones.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field} = {given} is not valid: {allowed}")]
pub struct Invalid {
    field: String,
    given: String,
    allowed: String,
}

pub type Result<T, E = Invalid> = std::result::Result<T, E>;

impl Invalid {
    pub fn new(field: impl Into<String>, given: impl fmt::Display, allowed: impl Into<String>) -> Self {
        Self { field: field.into(), given: cut(given.to_string()), allowed: allowed.into() }
    }

    /// Path of the field, as in `scene.layers[2].ior`.
    pub fn field(&self) -> &str {
        &self.field
    }

    /// The value that was given.
    pub fn given(&self) -> &str {
        &self.given
    }

    /// Description of the allowed values.
    pub fn allowed(&self) -> &str {
        &self.allowed
    }

    /// This error with another field.
    #[must_use]
    pub fn renamed(self, field: impl Into<String>) -> Self {
        Self { field: field.into(), ..self }
    }

    /// Prefixes the path with the place that holds the value.
    #[must_use]
    pub fn within(mut self, place: impl fmt::Display) -> Self {
        self.field = if self.field.starts_with('[') {
            format!("{place}{}", self.field)
        } else {
            format!("{place}.{}", self.field)
        };
        self
    }
}

/// Truncates the given value: it may be a megabyte long, and is quoted in headers and on terminals.
fn cut(mut given: String) -> String {
    const MOST_BYTES: usize = 200;
    if given.len() > MOST_BYTES {
        given.truncate(given.floor_char_boundary(MOST_BYTES));
        given.push('…');
    }
    given
}

/// A range check of a finite number; `allowed` describes the bounds.
pub(crate) fn check(field: &str, value: f64, ok: impl Fn(f64) -> bool, allowed: &str) -> Result<f64> {
    if value.is_finite() && ok(value) { Ok(value) } else { Err(Invalid::new(field, value, allowed)) }
}

/// Numbers the errors of a list's elements: `field[i]`.
pub fn each<T, U>(
    field: &str,
    items: impl IntoIterator<Item = T>,
    mut f: impl FnMut(T) -> Result<U>,
) -> Result<Vec<U>> {
    items
        .into_iter()
        .enumerate()
        .map(|(i, item)| f(item).map_err(|e| e.within(format_args!("{field}[{i}]"))))
        .collect()
}
