//! Decodes PGM and PPM, as `dcraw -E -4`, `dcraw -4` and LibRaw's `unprocessed_raw` write them, or with numbers as text.

use super::unreadable::UnreadablePhotograph;
use super::{About, Photograph, SampleLayout, checked_size};

pub(super) fn decode(bytes: &[u8]) -> Result<Photograph, UnreadablePhotograph> {
    let picture = NetpbmPicture::read(bytes)?;
    let (samples, rest) = if picture.is_text { picture.text(bytes)? } else { picture.binary(bytes)? };
    let count = 1 + pictures(rest);
    if count > 1 {
        return Err(UnreadablePhotograph::Pictures { count });
    }
    let NetpbmPicture { layout, width, height, most, .. } = picture;
    let white = (most < 65_535).then_some([most as f64; 4]);
    Ok(Photograph { width, height, layout, samples, black: None, white, about: About::default() })
}

/// Number of binary pictures in a file, which may be stored one after the other.
fn pictures(mut rest: &[u8]) -> usize {
    let mut count = 0;
    while let [b'P', b'5' | b'6', ..] = rest.trim_ascii_start() {
        count += 1;
        rest = rest.trim_ascii_start();
        rest =
            NetpbmPicture::read(rest).ok().and_then(|picture| rest.get(picture.end()..)).unwrap_or_default();
    }
    count
}

/// The values of a header, and the offset of the pixels.
struct NetpbmPicture {
    layout: SampleLayout,
    width: usize,
    height: usize,
    most: u64,
    /// Whether samples are decimal numbers.
    is_text: bool,
    from: usize,
}

impl NetpbmPicture {
    fn read(bytes: &[u8]) -> Result<Self, UnreadablePhotograph> {
        let layout =
            if matches!(bytes[1], b'3' | b'6') { SampleLayout::Rgb } else { SampleLayout::Mosaic(None) };
        let mut head = NetpbmHead { bytes, at: 2 };
        let width = head.number("width")?;
        let height = head.number("height")?;
        let most = head.number("greatest value")?;
        if most > 65_535 {
            let reason = format!("the greatest value is {most}, at most 65535 is allowed");
            return Err(UnreadablePhotograph::Damaged(reason));
        }
        if most < 256 {
            return Err(UnreadablePhotograph::EightBit { bits: 8 });
        }
        let (width, height) = checked_size(width, height)?;
        Ok(Self { layout, width, height, most, is_text: matches!(bytes[1], b'2' | b'3'), from: head.at + 1 })
    }

    fn count(&self) -> usize {
        self.width * self.height * self.layout.samples_per_pixel()
    }

    /// Offset of the end of binary samples.
    fn end(&self) -> usize {
        self.from + 2 * self.count()
    }

    /// The samples, and the bytes after them.
    fn binary<'b>(&self, bytes: &'b [u8]) -> Result<(Vec<u16>, &'b [u8]), UnreadablePhotograph> {
        let cut = || UnreadablePhotograph::Truncated {
            what: "the pixels".to_owned(),
            from: self.from as u64,
            to: self.end() as u64,
            has: bytes.len() as u64,
        };
        let pixels = bytes.get(self.from..self.end()).ok_or_else(cut)?;
        let samples = pixels.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
        Ok((samples, &bytes[self.end()..]))
    }

    /// The samples as decimal numbers. The rest is empty, since a file holds only one picture of this kind.
    fn text<'b>(&self, bytes: &'b [u8]) -> Result<(Vec<u16>, &'b [u8]), UnreadablePhotograph> {
        let mut body = NetpbmHead { bytes, at: self.from };
        let mut samples = Vec::with_capacity(self.count().min(bytes.len()));
        for i in 0..self.count() {
            let ends = || UnreadablePhotograph::Damaged(format!("{i} of {} samples are there", self.count()));
            let value = body.number("sample").map_err(|_| ends())?;
            if value > self.most {
                return Err(UnreadablePhotograph::Damaged(format!(
                    "a sample is {value}, the greatest is {}",
                    self.most
                )));
            }
            samples.push(value as u16);
        }
        Ok((samples, &[]))
    }
}

struct NetpbmHead<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl NetpbmHead<'_> {
    fn number(&mut self, what: &str) -> Result<u64, UnreadablePhotograph> {
        self.skip();
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let digits = rest.iter().take(10).take_while(|b| b.is_ascii_digit()).count();
        let text = std::str::from_utf8(&rest[..digits]).unwrap_or_default();
        self.at += digits;
        text.parse().map_err(|_| UnreadablePhotograph::Damaged(format!("the head has no {what}")))
    }

    /// Skips white space, and comments to the end of their line.
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
