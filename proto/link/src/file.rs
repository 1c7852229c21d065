//! Reads secret files in TOML.

use std::fs::File;
use std::io::{self, Read as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use serde::de::DeserializeOwned;

use crate::error::AccessError;

/// Certificates are not longer than this.
const LONGEST_BYTES: u64 = 1 << 20;

/// The permissions of users who are neither the owner nor in the group. The group may read, since that is how
/// Kubernetes mounts a secret for a user that is not root.
const OTHERS: u32 = 0o007;

/// Digest of a file's content; None if it cannot be read, or is no regular file.
pub(crate) fn digest(path: &Path) -> Option<blake3::Hash> {
    let file = File::open(path).ok().filter(|file| file.metadata().is_ok_and(|about| about.is_file()))?;
    let mut bytes = Vec::new();
    file.take(LONGEST_BYTES + 1).read_to_end(&mut bytes).ok()?;
    Some(blake3::hash(&bytes))
}

/// Reads a file that only its owner and group can open. `expected` describes the file that is meant.
pub(crate) fn read_secret<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<T, AccessError> {
    let failed = |source| AccessError::Read { path: path.to_owned(), source };
    let file = File::open(path).map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    if !metadata.is_file() {
        return Err(failed(io::Error::other("it is not a regular file")));
    }
    if metadata.mode() & OTHERS != 0 {
        return Err(AccessError::TooOpen { path: path.to_owned(), mode: metadata.mode() & 0o7777 });
    }
    if metadata.len() > LONGEST_BYTES {
        return Err(failed(io::Error::other(format!("it is longer than {LONGEST_BYTES} bytes"))));
    }
    let mut text = String::new();
    file.take(LONGEST_BYTES).read_to_string(&mut text).map_err(failed)?;
    toml::from_str(&text).map_err(|error| AccessError::Content {
        path: path.to_owned(),
        problem: format!("{}{} (this should be {expected})", place(&text, &error), discreet(error.message())),
    })
}

/// The line of an error. Its text is not shown, as the parser would by default: it may be a secret.
fn place(text: &str, error: &toml::de::Error) -> String {
    let before = error.span().and_then(|span| text.get(..span.start));
    before.map_or_else(String::new, |before| format!("line {}: ", before.matches('\n').count() + 1))
}

/// A message of the parser without words as long as tokens and keys: it quotes unknown names, and a secret may be in
/// the place of a name. No expected name is as long.
fn discreet(message: &str) -> String {
    const SHORTEST_SECRET: usize = 16;
    let is_part = |c: char| c.is_ascii_graphic() && !"`'\"".contains(c);
    let mut masked = String::with_capacity(message.len());
    for piece in message.split_inclusive(|c| !is_part(c)) {
        let word = piece.trim_end_matches(|c| !is_part(c));
        masked.push_str(if word.len() < SHORTEST_SECRET { word } else { "…" });
        masked.push_str(&piece[word.len()..]);
    }
    masked
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words as long as secrets are cut from messages.
    #[test]
    fn secrets_are_cut_from_messages() {
        let token = "338bfaf9b6bcd7452c482ed32cd9bfc71f9740a24ae71761dce5c67401770da0";
        let [variant, field] =
            ["unknown variant `…`, expected `worker`", "unknown field `…`, expected `name`"];
        for (message, masked) in [
            (variant.replace('…', &format!("worker{token}")), variant),
            (field.replace('…', token), field),
            ("missing field `certificate`".to_owned(), "missing field `certificate`"),
            (variant.replace('…', "Xk3!pQ9.rT7,Zz#1$vB%"), variant),
            (token.to_owned(), "…"),
        ] {
            assert_eq!(discreet(&message), masked);
        }
    }
}
