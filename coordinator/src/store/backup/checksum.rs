//! Computes BLAKE3 digests of files, and reads and writes the file next to a backup that holds its digest.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use super::{BackupError, Result, draft, failed};

/// A longer file is no checksum; names of files take at most 255 bytes, escaped at most twice that.
const LONGEST_BYTES: u64 = 1024;

pub(super) fn sidecar(file: &Path) -> PathBuf {
    draft::with_suffix(file, ".b3")
}

pub(super) fn of(reader: impl Read) -> std::io::Result<blake3::Hash> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(reader)?;
    Ok(hasher.finalize())
}

/// Writes the line with which `b3sum --check` finds the file in the same folder.
pub(super) fn write(sidecar: &Path, file: &Path, digest: blake3::Hash) -> Result<()> {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let mut out = File::create(sidecar).map_err(failed(sidecar, "cannot be created"))?;
    out.write_all(line(&name, digest).as_bytes())
        .and_then(|()| out.sync_all())
        .inspect_err(|_| _ = std::fs::remove_file(sidecar))
        .map_err(failed(sidecar, "writing to disk"))
}

/// As in b3sum, a backslash in front marks an escaped name.
fn line(name: &str, digest: blake3::Hash) -> String {
    let escaped = name.replace('\\', "\\\\").replace('\n', "\\n").replace('\r', "\\r");
    let mark = if escaped == name { "" } else { "\\" };
    format!("{mark}{digest}  {escaped}\n")
}

/// Reads the checksum next to a file, if there is one. The name in it does not matter: both may have been renamed.
pub(super) fn read(sidecar: &Path) -> Result<Option<blake3::Hash>> {
    let file = match File::open(sidecar) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(failed(sidecar, "cannot be read")(error)),
    };
    let mut bytes = Vec::new();
    file.take(LONGEST_BYTES).read_to_end(&mut bytes).map_err(failed(sidecar, "cannot be read"))?;
    parse(&bytes).map(Some).ok_or_else(|| BackupError::NotAChecksum { sidecar: sidecar.to_owned() })
}

fn parse(bytes: &[u8]) -> Option<blake3::Hash> {
    let line = bytes.strip_prefix(b"\\").unwrap_or(bytes);
    let (hex, rest) = line.split_at_checked(64)?;
    let ends = rest.first().is_none_or(u8::is_ascii_whitespace);
    if ends { blake3::Hash::from_hex(hex).ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A written checksum line is read back, whatever the file's name. Other text is not taken for one.
    #[test]
    fn checksums_round_trip_for_any_file_name() {
        let digest = blake3::hash(b"x");
        for name in ["farm.backup", "two words", "back\\slash", "line\nbreak", "ü"] {
            assert_eq!(parse(line(name, digest).as_bytes()), Some(digest), "{name:?}");
        }
        assert_eq!(line("a", digest), format!("{digest}  a\n"));
        assert_eq!(line("a\nb", digest), format!("\\{digest}  a\\nb\n"));
        let hex = digest.to_string();
        for text in [String::new(), hex[..63].to_owned(), format!("{hex}0  a"), format!("g{}", &hex[1..])] {
            assert_eq!(parse(text.as_bytes()), None, "{text}");
        }
    }
}
