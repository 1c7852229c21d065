//! Notes of assumptions made in reading a file, and of suspicious data.

use serde::Serialize;

/// One assumption or warning; a file has at most one of each kind.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Note {
    /// The kind, for programs; stable.
    pub code: &'static str,
    /// One sentence for people.
    pub text: String,
}

impl Note {
    pub(crate) fn new(code: &'static str, text: impl Into<String>) -> Self {
        Self { code, text: text.into() }
    }
}
