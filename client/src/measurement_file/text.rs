//! From the bytes of a file to text.

use std::borrow::Cow;
use std::io::Read;
use std::path::Path;

use anyhow::{Result, bail};
use encoding_rs::{Encoding, UTF_16BE, UTF_16LE, WINDOWS_1252};

use super::note::Note;

/// Largest file that is read, in bytes.
const LARGEST: u64 = 1 << 30;

/// The whole file, or what a pipe gives.
pub(super) fn read(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(LARGEST + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LARGEST {
        bail!("the file has more than {LARGEST} bytes, which is the most that is read");
    }
    Ok(bytes)
}

/// UTF-8 is read as it is; anything else with a note, if it can be told from its bytes.
pub(super) fn decode<'a>(bytes: &'a [u8], notes: &mut Vec<Note>) -> Result<Cow<'a, str>> {
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

/// The byte order of UTF-16 and the bytes after the mark. Without a mark it shows in the zeros of plain letters.
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

    #[test]
    fn every_encoding_gives_the_same_text_and_a_note() {
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
    fn what_is_no_text_is_refused() {
        let refused = |bytes: &[u8]| decode(bytes, &mut Vec::new()).unwrap_err().to_string();
        assert!(refused(b"PK\x03\x04rest").contains("spreadsheet"));
        assert!(refused(b"\x01\0\0\0\xffimage").contains("not text"));
    }
}
