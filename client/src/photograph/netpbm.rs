//! PGM and PPM, as `dcraw -E -4`, `dcraw -4` and LibRaw's `unprocessed_raw` write them.

use super::unreadable::Unreadable;
use super::{About, Layout, Photograph, checked_size};

pub(super) fn decode(bytes: &[u8]) -> Result<Photograph, Unreadable> {
    let layout = if bytes[1] == b'6' { Layout::Rgb } else { Layout::Mosaic(None) };
    let mut head = Head { bytes, at: 2 };
    let width = head.number("width")?;
    let height = head.number("height")?;
    let most = head.number("greatest value")?;
    if most > 65_535 {
        return Err(Unreadable::Damaged(format!("the greatest value is {most}, at most 65535 is allowed")));
    }
    if most < 256 {
        return Err(Unreadable::EightBit { bits: 8 });
    }
    let (width, height) = checked_size(width, height)?;
    let from = head.at + 1;
    let length = 2 * width * height * layout.samples_per_pixel();
    let cut = || Unreadable::Truncated {
        what: "the pixels".to_owned(),
        from: from as u64,
        to: (from + length) as u64,
        has: bytes.len() as u64,
    };
    let pixels = bytes.get(from..from + length).ok_or_else(cut)?;
    let samples = pixels.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
    let white = (most < 65_535).then_some(most as f64);
    Ok(Photograph { width, height, layout, samples, black: None, white, about: About::default() })
}

struct Head<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Head<'_> {
    fn number(&mut self, what: &str) -> Result<u64, Unreadable> {
        self.skip();
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let digits = rest.iter().take(10).take_while(|b| b.is_ascii_digit()).count();
        let text = std::str::from_utf8(&rest[..digits]).unwrap_or_default();
        self.at += digits;
        text.parse().map_err(|_| Unreadable::Damaged(format!("the head tells no {what}")))
    }

    /// Spaces, and comments to the end of their line.
    fn skip(&mut self) {
        while let Some(byte) = self.bytes.get(self.at) {
            match byte {
                b'#' => {
                    let rest = &self.bytes[self.at..];
                    self.at += rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
                }
                b if b.is_ascii_whitespace() => self.at += 1,
                _ => return,
            }
        }
    }
}
