//! The reasons why a file cannot be measured.

use super::{MOST_COMPRESSED, MOST_DIRECTORIES, MOST_PIXELS};

/// The reason why a file cannot be used, and the remedy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UnreadablePhotograph {
    #[error("the file is empty")]
    Empty,
    #[error(
        "the file is no DNG, TIFF, PNG, PGM or PPM: convert the camera's raw file with `dcraw -E -4 -T` or a DNG converter"
    )]
    UnknownFormat,
    #[error(
        "JPEG holds 8 bits after a tone curve, from which no radiance can be recovered: let the camera store raw files"
    )]
    Jpeg,
    #[error(
        "the DNG is compressed with loss, to 8 bits after a tone curve: convert the raw file again without lossy \
         compression"
    )]
    LossyDng,
    #[error(
        "{0} files, a camera's own format, are not read: convert them with a DNG converter or `dcraw -E -4 -T`"
    )]
    CamerasOwn(&'static str),
    #[error("{bits} bits a sample are too few: give raw files, or 16-bit linear ones of `dcraw -E -4 -T`")]
    EightBit { bits: u32 },
    #[error(
        "the values have gone through a tone curve ({seen}): convert without one, as `dcraw -E -4 -T` does"
    )]
    NotLinear { seen: String },
    #[error("{width} × {height} pixels are not read: allowed are 1 to {most}", most = MOST_PIXELS)]
    Size { width: u64, height: u64 },
    #[error(
        "{file_bytes} bytes are said to hold {samples} samples: those of a photograph are not compressed more than \
         {most}-fold", most = MOST_COMPRESSED
    )]
    Compressed { file_bytes: usize, samples: u64 },
    #[error("the file is cut off or damaged: {what} should be at bytes {from} to {to}, the file has {has}")]
    Truncated { what: String, from: u64, to: u64, has: u64 },
    #[error(
        "the file holds {}{count} pictures, of which one would be used: save each as a file of its own (`tiffsplit \
         FILE`; ImageJ: Stack to Images); red, green and blue as pages are to be merged to RGB (ImageJ: Merge Channels, or \
         `convert FILE -combine`)", if *count >= MOST_DIRECTORIES { "at least " } else { "" }
    )]
    Pictures { count: usize },
    #[error(
        "the picture ends early, as after an interrupted copy: {rows} of its {height} rows are there; copy the file \
         again"
    )]
    EndsEarly { rows: usize, height: usize },
    #[error(
        "rows {from} to {to}, the last ones, hold nothing but zeros, as after an interrupted copy: copy the file again, \
         or cut a margin that is no picture off"
    )]
    ZeroRows { from: usize, to: usize },
    #[error("tag {tag} = {given} is not valid: {allowed}")]
    Tag { tag: String, given: String, allowed: String },
    #[error("tag {tag} is missing: {needed}")]
    Missing { tag: String, needed: String },
    #[error("the file is damaged: {0}")]
    Damaged(String),
}

impl UnreadablePhotograph {
    pub(super) fn tag(tag: &str, given: impl std::fmt::Display, allowed: impl Into<String>) -> Self {
        Self::Tag { tag: tag.to_owned(), given: given.to_string(), allowed: allowed.into() }
    }

    pub(super) fn missing(tag: &str, needed: impl Into<String>) -> Self {
        Self::Missing { tag: tag.to_owned(), needed: needed.into() }
    }
}
