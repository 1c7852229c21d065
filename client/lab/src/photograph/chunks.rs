//! Decodes strips and tiles of a TIFF to samples.

use std::io::Read as _;

use flate2::read::ZlibDecoder;
use rayon::prelude::*;
use weezl::decode::Decoder;
use weezl::{BitOrder, LzwStatus};

use super::directory::{Bytes, Directory, Tag};
use super::lossless_jpeg::LosslessJpeg;
use super::unreadable::UnreadablePhotograph;
use super::{checked_samples, checked_size};

/// Upper limit of the compression ratio of LZW.
const MOST_LZW: usize = 4096;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compression {
    None,
    Deflate,
    Lzw,
    LosslessJpeg,
}

/// Decoded samples of a strip or tile.
struct Decoded {
    samples: Vec<u16>,
    /// Samples per row: of the whole tile, or of its part within the picture.
    row: usize,
}

/// A picture's samples as stored in the file.
#[derive(Debug)]
pub(super) struct Chunks<'a> {
    width: usize,
    height: usize,
    samples_per_pixel: usize,
    bits: u32,
    big_endian: bool,
    compression: Compression,
    /// Whether samples are stored as differences from their left neighbours.
    differences: bool,
    chunk_width: usize,
    chunk_height: usize,
    /// Strips or tiles, row by row.
    stored: Vec<&'a [u8]>,
}

impl<'a> Chunks<'a> {
    pub(super) fn new(
        bytes: Bytes<'a>,
        picture: &Directory<'a>,
        samples_per_pixel: usize,
        bits: u32,
    ) -> Result<Self, UnreadablePhotograph> {
        let (width, height) = checked_size(picture.needed(Tag::WIDTH)?, picture.needed(Tag::HEIGHT)?)?;
        let compression = compression(picture)?;
        // Some writers give the size of tiles in addition to the offsets of strips.
        let tiled = picture.has(Tag::TILE_WIDTH) && picture.has(Tag::TILE_OFFSETS);
        let (chunk_width, chunk_height) = if tiled {
            // A tile may extend beyond a small picture.
            let (w, h) = (picture.needed(Tag::TILE_WIDTH)?, picture.needed(Tag::TILE_HEIGHT)?);
            checked_size(w, h)?
        } else {
            let rows = picture.whole_of(Tag::ROWS_PER_STRIP)?.unwrap_or(height as u64);
            (width, rows.clamp(1, height as u64) as usize)
        };
        let chunks = Self {
            width,
            height,
            samples_per_pixel,
            bits,
            big_endian: bytes.big_endian,
            compression,
            differences: differences(picture, compression, bits)?,
            chunk_width,
            chunk_height,
            stored: stored(bytes, picture, tiled)?,
        };
        chunks.check(bytes.all.len())?;
        Ok(chunks)
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }

    pub(super) fn height(&self) -> usize {
        self.height
    }

    /// Refuses more samples than the file can hold, before memory is allocated.
    fn check(&self, file_bytes: usize) -> Result<(), UnreadablePhotograph> {
        let (across, down) = (self.width.div_ceil(self.chunk_width), self.height.div_ceil(self.chunk_height));
        let wanted = across * down;
        if self.stored.len() != wanted {
            let given = format!("{} strips or tiles", self.stored.len());
            return Err(UnreadablePhotograph::tag(
                Tag::STRIP_OFFSETS.name,
                given,
                format!("{wanted} make the picture"),
            ));
        }
        // Tiles are decoded whole, and several may share an offset in the file.
        let [width, height] = [across * self.chunk_width, down * self.chunk_height].map(|side| side as u64);
        checked_samples(
            file_bytes,
            width.saturating_mul(height).saturating_mul(self.samples_per_pixel as u64),
        )
    }

    /// All samples, row by row.
    pub(super) fn read(&self) -> Result<Vec<u16>, UnreadablePhotograph> {
        if self.compression == Compression::None {
            // Each strip or tile is checked before memory is allocated for all.
            for (chunk, stored) in self.stored.iter().enumerate() {
                self.packing(chunk, stored)?;
            }
        }
        let across = self.width.div_ceil(self.chunk_width);
        let row = self.width * self.samples_per_pixel;
        let mut samples = vec![0; row * self.height];
        let bands = samples.par_chunks_mut(row * self.chunk_height).enumerate();
        let bands = bands.map(|(band, target)| {
            for column in 0..across {
                let chunk = band * across + column;
                let decoded = self.decode(chunk).map_err(|e| self.within_picture(e, band))?;
                let left = column * self.chunk_width * self.samples_per_pixel;
                let kept = self.within(chunk).0 * self.samples_per_pixel;
                for (target, line) in
                    target.chunks_exact_mut(row).zip(decoded.samples.chunks_exact(decoded.row))
                {
                    target[left..left + kept].copy_from_slice(&line[..kept]);
                }
            }
            Ok(())
        });
        // The first error in the order of the file is reported, whichever occurred first.
        bands.collect::<Vec<_>>().into_iter().collect::<Result<(), _>>()?;
        Ok(samples)
    }

    /// Columns and rows of a strip or tile that are within the picture.
    fn within(&self, chunk: usize) -> (usize, usize) {
        let across = self.width.div_ceil(self.chunk_width);
        let left = |at: usize, side: usize, whole: usize| (whole - (at * side).min(whole)).min(side);
        (
            left(chunk % across, self.chunk_width, self.width),
            left(chunk / across, self.chunk_height, self.height),
        )
    }

    /// Converts the missing rows of a strip or tile to those of the picture.
    fn within_picture(&self, error: UnreadablePhotograph, band: usize) -> UnreadablePhotograph {
        match error {
            UnreadablePhotograph::EndsEarly { rows, .. } => {
                let rows = (band * self.chunk_height + rows).min(self.height);
                UnreadablePhotograph::EndsEarly { rows, height: self.height }
            }
            other => other,
        }
    }

    fn decode(&self, chunk: usize) -> Result<Decoded, UnreadablePhotograph> {
        let stored = self.stored[chunk];
        let mut decoded = match self.compression {
            Compression::None => self.unpack(chunk, stored)?,
            Compression::Deflate => self.unpack(chunk, &inflate(stored, self.most_bytes())?)?,
            Compression::Lzw => self.unpack(chunk, &unlzw(stored, self.most_bytes())?)?,
            Compression::LosslessJpeg => self.unjpeg(chunk, stored)?,
        };
        if self.differences {
            let n = self.samples_per_pixel;
            for row in decoded.samples.chunks_exact_mut(decoded.row) {
                for i in n..row.len() {
                    row[i] = row[i].wrapping_add(row[i - n]);
                }
            }
        }
        Ok(decoded)
    }

    fn most_bytes(&self) -> usize {
        2 * self.chunk_width * self.samples_per_pixel * self.chunk_height
    }

    /// Decodes a tile's JPEG, which is as large as the tile or as its part within the picture; the same samples may be
    /// arranged in rows of another length.
    fn unjpeg(&self, chunk: usize, stored: &[u8]) -> Result<Decoded, UnreadablePhotograph> {
        let (width, height) = self.within(chunk);
        let samples = |width: usize, height: usize| width * height * self.samples_per_pixel;
        let whole = samples(self.chunk_width, self.chunk_height);
        let last = samples(self.chunk_width, height);
        let jpeg = LosslessJpeg::new(stored)?;
        let row = if [whole, last].contains(&jpeg.samples()) {
            self.chunk_width * self.samples_per_pixel
        } else {
            jpeg.row()
        };
        let rows = jpeg.samples() / row.max(1);
        let fits = row >= samples(width, 1) && rows >= height && jpeg.samples() <= whole;
        if !fits {
            let has = jpeg.samples();
            return Err(UnreadablePhotograph::Damaged(format!(
                "a lossless JPEG has {has} samples instead of {last}"
            )));
        }
        Ok(Decoded { samples: jpeg.decode()?, row })
    }

    fn unpack(&self, chunk: usize, bytes: &[u8]) -> Result<Decoded, UnreadablePhotograph> {
        let (row, bits) = self.packing(chunk, bytes)?;
        Ok(Decoded { samples: unpacked(bytes, row, bits, self.big_endian), row })
    }

    /// Samples per row and bits per sample as stored: the last tiles may be whole or cut to the picture, and samples of
    /// 9 to 15 bits may be in words of 16 bits, which the tags do not show.
    fn packing(&self, chunk: usize, bytes: &[u8]) -> Result<(usize, u32), UnreadablePhotograph> {
        let whole_row = self.chunk_width * self.samples_per_pixel;
        let (width, height) = self.within(chunk);
        let rows = [whole_row, width * self.samples_per_pixel];
        let is_exact = |row: usize, bits: u32| {
            [self.chunk_height, height].iter().any(|rows| bytes.len() == bytes_of_row(row, bits) * rows)
        };
        if self.bits < 16 {
            let has_surplus = |row| row == whole_row && bytes.len() > 2 * row * self.chunk_height;
            let mut words = rows.into_iter().filter(|row| is_exact(*row, 16) || has_surplus(*row));
            let fits = |row| unpacked(bytes, row, 16, self.big_endian).iter().all(|v| v >> self.bits == 0);
            if let Some(row) = words.find(|row| fits(*row)) {
                return Ok((row, 16));
            }
        }
        if let Some(row) = rows.into_iter().find(|row| is_exact(*row, self.bits)) {
            return self.packed(row, bytes.len());
        }
        let (has, wanted) = (bytes.len(), bytes_of_row(whole_row, self.bits) * height);
        if has < wanted {
            return Err(UnreadablePhotograph::Damaged(format!(
                "a strip or tile has {has} bytes, {wanted} are needed"
            )));
        }
        self.packed(whole_row, has)
    }

    /// Refuses words of 16 bits whose values need more bits than the tags state.
    fn packed(&self, row: usize, has: usize) -> Result<(usize, u32), UnreadablePhotograph> {
        if self.bits < 16 && has >= 2 * row * self.chunk_height {
            let given = format!("{} with 16 bits stored for each sample", self.bits);
            let allowed = "larger values are stored: convert with a DNG converter or `dcraw -E -4 -T`";
            return Err(UnreadablePhotograph::tag(Tag::BITS.name, given, allowed));
        }
        Ok((row, self.bits))
    }
}

fn bytes_of_row(row: usize, bits: u32) -> usize {
    (row * bits as usize).div_ceil(8)
}

/// Unpacks samples: those of 16 bits are in the file's byte order, those of fewer bits are packed, the highest bit
/// first, and rows begin with a byte.
fn unpacked(bytes: &[u8], row: usize, bits: u32, big_endian: bool) -> Vec<u16> {
    if bits == 16 {
        let one = if big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
        return bytes.chunks_exact(2).map(|b| one([b[0], b[1]])).collect();
    }
    let mut samples = Vec::with_capacity(bytes.len() * 8 / bits as usize);
    for line in bytes.chunks_exact(bytes_of_row(row, bits)) {
        let (mut word, mut held, mut rest) = (0_u32, 0, line.iter());
        for _ in 0..row {
            while held < bits {
                word = word << 8 | u32::from(*rest.next().unwrap_or(&0));
                held += 8;
            }
            held -= bits;
            samples.push((word >> held & ((1 << bits) - 1)) as u16);
        }
    }
    samples
}

fn inflate(stored: &[u8], most: usize) -> Result<Vec<u8>, UnreadablePhotograph> {
    let mut bytes = Vec::new();
    let read = ZlibDecoder::new(stored).take(most as u64).read_to_end(&mut bytes);
    read.map_err(|e| UnreadablePhotograph::Damaged(format!("a strip or tile: {e}")))?;
    Ok(bytes)
}

fn unlzw(stored: &[u8], most: usize) -> Result<Vec<u8>, UnreadablePhotograph> {
    let mut bytes = vec![0; most.min(stored.len().saturating_mul(MOST_LZW))];
    let mut decoder = Decoder::with_tiff_size_switch(BitOrder::Msb, 8);
    let (mut from, mut to) = (0, 0);
    while to < bytes.len() {
        let read = decoder.decode_bytes(&stored[from..], &mut bytes[to..]);
        from += read.consumed_in;
        to += read.consumed_out;
        match read.status {
            Ok(LzwStatus::Ok) if read.consumed_in + read.consumed_out > 0 => {}
            Ok(_) => break,
            Err(error) => return Err(UnreadablePhotograph::Damaged(format!("a strip or tile: {error}"))),
        }
    }
    bytes.truncate(to);
    Ok(bytes)
}

fn compression(picture: &Directory) -> Result<Compression, UnreadablePhotograph> {
    match picture.whole_of(Tag::COMPRESSION)?.unwrap_or(1) {
        1 => Ok(Compression::None),
        5 => Ok(Compression::Lzw),
        8 | 32_946 => Ok(Compression::Deflate),
        7 => Ok(Compression::LosslessJpeg),
        6 => Err(UnreadablePhotograph::Jpeg),
        34_892 => Err(UnreadablePhotograph::LossyDng),
        other => Err(refused(other)),
    }
}

fn refused(compression: u64) -> UnreadablePhotograph {
    let name = match compression {
        32_767 => " (Sony's own)",
        32_773 => " (PackBits)",
        34_713 => " (Nikon's own)",
        52_546 => " (JPEG XL of DNG 1.7)",
        65_000 => " (Kodak's own)",
        65_535 => " (Pentax's own)",
        _ => "",
    };
    let allowed = "allowed are 1 (none), 5 (LZW), 7 (lossless JPEG), 8 (deflate): convert with a DNG converter, \
                   compatible with DNG 1.4 and without lossy compression, or `dcraw -E -4 -T`";
    UnreadablePhotograph::tag(Tag::COMPRESSION.name, format_args!("{compression}{name}"), allowed)
}

fn differences(
    picture: &Directory,
    compression: Compression,
    bits: u32,
) -> Result<bool, UnreadablePhotograph> {
    match picture.whole_of(Tag::PREDICTOR)?.unwrap_or(1) {
        // Without compression, or with that of JPEG, the tag has no meaning.
        2 if matches!(compression, Compression::None | Compression::LosslessJpeg) => Ok(false),
        2 if bits == 16 => Ok(true),
        1 => Ok(false),
        other => {
            Err(UnreadablePhotograph::tag(Tag::PREDICTOR.name, other, "allowed are 1 and, with 16 bits, 2"))
        }
    }
}

fn stored<'a>(
    bytes: Bytes<'a>,
    picture: &Directory<'a>,
    tiled: bool,
) -> Result<Vec<&'a [u8]>, UnreadablePhotograph> {
    let (offsets, lengths, what) = if tiled {
        (Tag::TILE_OFFSETS, Tag::TILE_BYTES, "a tile")
    } else {
        (Tag::STRIP_OFFSETS, Tag::STRIP_BYTES, "a strip")
    };
    let (from, length) = (picture.whole(offsets)?, picture.whole(lengths)?);
    if from.is_empty() || from.len() != length.len() {
        let given = format!("{} places and {} lengths", from.len(), length.len());
        return Err(UnreadablePhotograph::tag(
            offsets.name,
            given,
            "one of each is needed for every strip or tile",
        ));
    }
    from.iter().zip(&length).map(|(from, length)| bytes.slice(what, *from, *length)).collect()
}
