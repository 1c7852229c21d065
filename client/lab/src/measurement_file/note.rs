//! What was assumed when a file was read, and what its data make suspicious.

use serde::Serialize;

/// One assumption or warning; a file has at most one of a kind.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Note {
    /// The kind, as programs read it; never changed.
    pub code: &'static str,
    /// One sentence for people.
    pub text: String,
}

impl Note {
    pub(super) fn new(code: &'static str, text: impl Into<String>) -> Self {
        Self { code, text: text.into() }
    }
}
