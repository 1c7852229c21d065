//! Decodes the bytes of a file to text.

use std::borrow::Cow;
use std::path::Path;

use anyhow::{Context, Result, bail};
use encoding_rs::{Encoding, UTF_16BE, UTF_16LE, WINDOWS_1252};

use super::note::Note;
use crate::bounded_file;

/// Largest file that is read, in bytes.
const LARGEST: u64 = 1 << 30;

/// Largest compression ratio of numbers as text; files up to `SMALL_BYTES` may exceed it.
const MOST_COMPRESSED: u64 = 100;
const SMALL_BYTES: u64 = 16 << 20;

/// The file name that denotes standard input.
pub(super) const STDIN: &str = "-";

/// First bytes of compressed files, and the program that unpacks them.
const PACKED: [(&[u8], &str); 3] =
    [(b"\x28\xb5\x2f\xfd", "unzstd"), (b"\xfd7zXZ", "unxz"), (b"BZh", "bunzip2")];

/// All bytes of the file, or of standard input.
pub(super) fn read(path: &Path) -> Result<Vec<u8>> {
    if path != Path::new(STDIN) {
        return bounded_file::read(path, LARGEST);
    }
    let mut bytes = Vec::new();
    bounded_file::fill(&mut bytes, std::io::stdin().lock(), LARGEST)?;
    Ok(bytes)
}

/// The contents of a gzip file, or the bytes unchanged; files of other compressors are refused.
pub(super) fn unpacked<'a>(bytes: &'a [u8], notes: &mut Vec<Note>) -> Result<Cow<'a, [u8]>> {
    if let Some((_, program)) = PACKED.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        bail!("this is a compressed file: unpack it first, as with {program}");
    }
    if !bytes.starts_with(b"\x1f\x8b") {
        return Ok(Cow::Borrowed(bytes));
    }
    notes.push(Note::new("GZIP", "the file is compressed with gzip, and was unpacked"));
    let most = LARGEST.min(MOST_COMPRESSED * bytes.len() as u64 + SMALL_BYTES);
    let mut text = Vec::new();
    bounded_file::fill(&mut text, flate2::read::MultiGzDecoder::new(bytes), most)
        .context("this is a gzip file that cannot be unpacked")?;
    Ok(Cow::Owned(text))
}

/// The text of a file other than a measurement: UTF-8, with or without a byte-order mark, or UTF-16.
pub fn plain(bytes: &[u8]) -> Result<String> {
    let decoded = match utf_16(bytes) {
        Some((encoding, rest)) => {
            encoding.decode_without_bom_handling_and_without_replacement(rest).map(Cow::into_owned)
        }
        None => {
            std::str::from_utf8(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)).ok().map(str::to_owned)
        }
    };
    decoded.context("the file is not text in UTF-8: save it as UTF-8")
}

/// The text of a file. Line ends of a lone CR become LF, since comments would not end otherwise.
pub(super) fn decode<'a>(bytes: &'a [u8], notes: &mut Vec<Note>) -> Result<Cow<'a, str>> {
    let text = decode_bytes(bytes, notes)?;
    let lone = |(i, _): (usize, &str)| text.as_bytes().get(i + 1) != Some(&b'\n');
    if text.match_indices('\r').any(lone) {
        return Ok(Cow::Owned(text.replace("\r\n", "\n").replace('\r', "\n")));
    }
    Ok(text)
}

/// Decodes UTF-8, UTF-16 and Windows-1252. A byte-order mark and any encoding other than UTF-8 cause a note.
fn decode_bytes<'a>(bytes: &'a [u8], notes: &mut Vec<Note>) -> Result<Cow<'a, str>> {
    if bytes.starts_with(b"PK\x03\x04") || bytes.starts_with(b"\xd0\xcf\x11\xe0") {
        bail!("this is a spreadsheet, not CSV: save it as CSV from the program that made it");
    }
    let mut note = |text: &str| notes.push(Note::new("ENCODING", text));
    if let Some(rest) = bytes.strip_prefix(b"\xef\xbb\xbf") {
        note("the file begins with a byte-order mark, which is left out");
        return utf8_or_western(rest, notes);
    }
    if let Some((encoding, rest)) = utf_16(bytes) {
        note(&format!("the file is {}, not UTF-8", encoding.name()));
        let (text, malformed) = encoding.decode_without_bom_handling(rest);
        if malformed {
            bail!("the file seems to be {}, but is damaged: save it as UTF-8", encoding.name());
        }
        return Ok(text);
    }
    utf8_or_western(bytes, notes)
}

fn utf8_or_western<'a>(bytes: &'a [u8], notes: &mut Vec<Note>) -> Result<Cow<'a, str>> {
    if bytes.contains(&0) {
        bail!("this is not text, since it holds zero bytes: save the measurement as CSV in UTF-8");
    }
    if let Ok(text) = std::str::from_utf8(bytes) {
        return Ok(Cow::Borrowed(text));
    }
    notes.push(Note::new("ENCODING", "the file is not UTF-8 and was read as Windows-1252"));
    Ok(WINDOWS_1252.decode_without_bom_handling(bytes).0)
}

/// The byte order of UTF-16, and the bytes after the mark. Without a mark it follows from the zero bytes of ASCII
/// letters.
fn utf_16(bytes: &[u8]) -> Option<(&'static Encoding, &[u8])> {
    if let Some(rest) = bytes.strip_prefix(b"\xff\xfe") {
        return Some((UTF_16LE, rest));
    }
    if let Some(rest) = bytes.strip_prefix(b"\xfe\xff") {
        return Some((UTF_16BE, rest));
    }
    let head = &bytes[..bytes.len().min(64) & !1];
    let zeros = |offset: usize| head.iter().skip(offset).step_by(2).filter(|b| **b == 0).count();
    let most = head.len() * 3 / 8;
    match (zeros(0), zeros(1)) {
        (0, odd) if odd > most => Some((UTF_16LE, bytes)),
        (even, 0) if even > most => Some((UTF_16BE, bytes)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn utf_16_bytes(text: &str, little: bool, mark: bool) -> Vec<u8> {
        let mark = if mark { "\u{feff}" } else { "" };
        let units = mark.encode_utf16().chain(text.encode_utf16());
        units.flat_map(|u| if little { u.to_le_bytes() } else { u.to_be_bytes() }).collect()
    }

    /// Every encoding gives the same text and a note.
    #[test]
    fn every_encoding_gives_the_same_text() {
        let text = "material,channel,thickness_mm\nwei\u{df},R,0.5\n";
        let western: Vec<u8> = text.chars().map(|c| c as u8).collect();
        let marked = [b"\xef\xbb\xbf", text.as_bytes()].concat();
        let wide = [(true, true), (false, true), (true, false), (false, false)];
        let wide = wide.map(|(little, mark)| utf_16_bytes(text, little, mark));
        for bytes in [western, marked].into_iter().chain(wide) {
            let mut notes = Vec::new();
            assert_eq!(decode(&bytes, &mut notes).unwrap(), text);
            assert_eq!(notes.iter().map(|n| n.code).collect::<Vec<_>>(), ["ENCODING"], "{bytes:?}");
        }
        let mut notes = Vec::new();
        assert_eq!(decode(text.as_bytes(), &mut notes).unwrap(), text);
        assert!(notes.is_empty());
    }

    #[test]
    fn lines_that_end_in_cr_become_lines() {
        let decoded = |text: &str| decode(text.as_bytes(), &mut Vec::new()).unwrap().into_owned();
        assert_eq!(decoded("a\r# b\rc\r"), "a\n# b\nc\n");
        assert_eq!(decoded("# a\r\nb\rc"), "# a\nb\nc");
        assert_eq!(decoded("a\r\nb\r\n"), "a\r\nb\r\n", "these are lines as they are");
    }

    /// Gzip is unpacked, and other packed files are refused.
    #[test]
    fn only_gzip_is_unpacked() {
        use std::io::Write as _;
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        packed.write_all(b"material,channel\n").unwrap();
        let packed = packed.finish().unwrap();
        let mut notes = Vec::new();
        assert_eq!(&*unpacked(&packed, &mut notes).unwrap(), b"material,channel\n");
        assert_eq!(notes[0].code, "GZIP");
        let refused = |bytes: &[u8]| format!("{:#}", unpacked(bytes, &mut Vec::new()).unwrap_err());
        assert!(refused(&packed[..20]).starts_with("this is a gzip file that cannot be unpacked"));
        assert!(refused(b"\x28\xb5\x2f\xfdrest").ends_with("unpack it first, as with unzstd"));
    }

    /// Files other than measurements are read as UTF-8 or UTF-16.
    #[test]
    fn utf_8_and_utf_16_are_read() {
        let text = "material = 'wei\u{df}'\n";
        let marked = [b"\xef\xbb\xbf", text.as_bytes()].concat();
        for bytes in [
            text.as_bytes().to_vec(),
            marked,
            utf_16_bytes(text, true, true),
            utf_16_bytes(text, false, true),
        ] {
            assert_eq!(plain(&bytes).unwrap(), text);
        }
        assert!(plain(b"wei\xdf").unwrap_err().to_string().ends_with("save it as UTF-8"));
    }

    /// Data that are not text are refused.
    #[test]
    fn binary_data_are_refused() {
        let refused = |bytes: &[u8]| decode(bytes, &mut Vec::new()).unwrap_err().to_string();
        assert!(refused(b"PK\x03\x04rest").contains("spreadsheet"));
        assert!(refused(b"\x01\0\0\0\xffimage").contains("not text"));
    }
}
