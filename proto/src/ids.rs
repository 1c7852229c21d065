//! Defines names, identifiers and the limits that bound every request.

use std::fmt;

use optics_model::invalid::{Invalid, Result};

/// Name of a dictionary: 1 to 64 letters, digits, `-`, `_` or `.`, beginning with a letter or digit.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct DictionaryName(String);

impl DictionaryName {
    pub fn new(name: impl Into<String>) -> Result<Self> {
        let name = name.into();
        let ok = (1..=64).contains(&name.len())
            && name.starts_with(|c: char| c.is_ascii_alphanumeric())
            && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
        if ok {
            return Ok(Self(name));
        }
        let allowed = "1 to 64 letters, digits, '-', '_' or '.', beginning with a letter or digit";
        Err(Invalid::new("name", format_args!("{name:?}"), allowed))
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for DictionaryName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Number of a dictionary in the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct DictionaryId(pub i64);

/// Identifier that the coordinator assigned to a worker at registration.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WorkerId(pub String);

impl fmt::Display for WorkerId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Random number that proves that a lease was granted. 0 is not valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Token(pub u128);

impl Token {
    /// Parses 32 hexadecimal digits; any other text gives the invalid 0.
    pub fn parse(text: &str) -> Self {
        Self(if text.len() == 32 { u128::from_str_radix(text, 16).unwrap_or(0) } else { 0 })
    }
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

/// Limits of one gRPC message or call.
#[derive(Debug)]
pub struct RequestLimits;

impl RequestLimits {
    /// Largest gRPC message in bytes: a record with 64 channels of 8192 pixels and derivatives has 12 MiB.
    pub const MESSAGE_BYTES: usize = 16 << 20;
    /// Largest size of a question about measurements, in bytes for each pixel that it may have: three numbers, and as
    /// much again as one, so that a question with too many pixels is refused by their number rather than by its bytes.
    pub const PIXEL_BYTES: usize = 32;
    /// Most leases of one call.
    pub const LEASES: u32 = 1024;
    /// Most records that one call selects by their numbers.
    pub const INDICES: usize = 10_000;
    /// Lowest and highest priority of a dictionary.
    pub const PRIORITY: std::ops::RangeInclusive<i32> = -1000..=1000;
    /// Longest label, reason or other text for people that is kept, in bytes.
    pub const TEXT_BYTES: usize = 1000;
    /// Longest note about a kept measurement, in bytes.
    pub const NOTE_BYTES: usize = 10_000;
    /// Longest wait for work.
    pub const WAIT_MS: u64 = 30_000;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names that would do harm in a shell or a path are refused.
    #[test]
    fn unsafe_dictionary_names_are_refused() {
        for good in ["paper", "a", "2026-11.fine_grid"] {
            assert!(DictionaryName::new(good).is_ok(), "{good}");
        }
        for bad in ["", "-x", "../x", "a b", "ä", &"x".repeat(65)] {
            assert!(DictionaryName::new(bad).is_err(), "{bad}");
        }
    }
}
