//! Strips and tiles of a TIFF: from stored bytes to samples.

use std::io::Read as _;

use flate2::read::ZlibDecoder;
use rayon::prelude::*;

use super::directory::{Bytes, Directory, Tag};
use super::unreadable::Unreadable;
use super::{checked_size, lossless_jpeg};

/// Deflate makes nothing more than this many times smaller; of lossless JPEG, every sample takes a bit at least.
const MOST_DEFLATED: u64 = 1032;
const MOST_SAMPLES_A_BYTE: u64 = 8;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compression {
    None,
    Deflate,
    LosslessJpeg,
}

/// A picture's samples as they lie in a file.
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
    /// Row by row.
    stored: Vec<&'a [u8]>,
}

impl<'a> Chunks<'a> {
    pub(super) fn new(
        bytes: Bytes<'a>,
        picture: &Directory<'a>,
        samples_per_pixel: usize,
        bits: u32,
    ) -> Result<Self, Unreadable> {
        let (width, height) = checked_size(picture.needed(Tag::WIDTH)?, picture.needed(Tag::HEIGHT)?)?;
        let compression = compression(picture)?;
        let tiled = picture.has(Tag::TILE_WIDTH);
        let (chunk_width, chunk_height) = if tiled {
            // A tile may reach beyond a small picture.
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
        chunks.check()?;
        Ok(chunks)
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }

    pub(super) fn height(&self) -> usize {
        self.height
    }

    /// Refuses what cannot be in so few bytes, before memory is taken for it.
    fn check(&self) -> Result<(), Unreadable> {
        let wanted = self.width.div_ceil(self.chunk_width) * self.height.div_ceil(self.chunk_height);
        if self.stored.len() != wanted {
            let given = format!("{} strips or tiles", self.stored.len());
            return Err(Unreadable::tag(
                Tag::STRIP_OFFSETS.name,
                given,
                format!("{wanted} make the picture"),
            ));
        }
        let stored: u64 = self.stored.iter().map(|bytes| bytes.len() as u64).sum();
        let samples = (self.width * self.height * self.samples_per_pixel) as u64;
        let most = match self.compression {
            Compression::None => return Ok(()),
            Compression::Deflate => stored.saturating_mul(MOST_DEFLATED) / 2,
            Compression::LosslessJpeg => stored.saturating_mul(MOST_SAMPLES_A_BYTE),
        };
        if samples > most {
            return Err(Unreadable::Damaged(format!("{stored} bytes cannot hold {samples} samples")));
        }
        Ok(())
    }

    /// All samples, row by row.
    pub(super) fn read(&self) -> Result<Vec<u16>, Unreadable> {
        if self.compression == Compression::None {
            // Each is looked at before memory is taken for all.
            for (i, stored) in self.stored.iter().enumerate() {
                self.whole(stored, self.rows_of(i))?;
            }
        }
        let across = self.width.div_ceil(self.chunk_width);
        let row = self.width * self.samples_per_pixel;
        let mut samples = vec![0; row * self.height];
        let bands = samples.par_chunks_mut(row * self.chunk_height).enumerate();
        bands.try_for_each(|(band, target)| {
            for column in 0..across {
                let chunk = band * across + column;
                let decoded = self.decode(self.stored[chunk], self.rows_of(chunk))?;
                let left = column * self.chunk_width;
                let kept = (self.width - left).min(self.chunk_width) * self.samples_per_pixel;
                let lines = decoded.chunks_exact(self.chunk_width * self.samples_per_pixel);
                for (target, line) in target.chunks_exact_mut(row).zip(lines) {
                    let left = left * self.samples_per_pixel;
                    target[left..left + kept].copy_from_slice(&line[..kept]);
                }
            }
            Ok(())
        })?;
        Ok(samples)
    }

    /// Rows that a strip or tile holds: the last strip is as high as what is left, tiles are all alike.
    fn rows_of(&self, chunk: usize) -> usize {
        if self.chunk_width == self.width {
            (self.height - (chunk * self.chunk_height).min(self.height)).min(self.chunk_height)
        } else {
            self.chunk_height
        }
    }

    fn bytes_of_row(&self) -> usize {
        (self.chunk_width * self.samples_per_pixel * self.bits as usize).div_ceil(8)
    }

    /// The bytes of so many rows.
    fn whole<'b>(&self, bytes: &'b [u8], rows: usize) -> Result<&'b [u8], Unreadable> {
        let wanted = self.bytes_of_row() * rows;
        let damaged =
            || Unreadable::Damaged(format!("a strip or tile has {} bytes, {wanted} are needed", bytes.len()));
        bytes.get(..wanted).ok_or_else(damaged)
    }

    fn decode(&self, stored: &[u8], rows: usize) -> Result<Vec<u16>, Unreadable> {
        let mut samples = match self.compression {
            Compression::None => self.unpack(self.whole(stored, rows)?),
            Compression::Deflate => {
                let mut bytes = Vec::new();
                let most = (self.bytes_of_row() * rows) as u64;
                let read = ZlibDecoder::new(stored).take(most).read_to_end(&mut bytes);
                read.map_err(|e| Unreadable::Damaged(format!("a strip or tile: {e}")))?;
                self.unpack(self.whole(&bytes, rows)?)
            }
            Compression::LosslessJpeg => {
                let wanted = self.chunk_width * self.samples_per_pixel * rows;
                lossless_jpeg::decode(stored, wanted)?
            }
        };
        if self.differences {
            let n = self.samples_per_pixel;
            for row in samples.chunks_exact_mut(self.chunk_width * n) {
                for i in n..row.len() {
                    row[i] = row[i].wrapping_add(row[i - n]);
                }
            }
        }
        Ok(samples)
    }

    /// Samples of 16 bits in the file's order of bytes; those of fewer bits are packed, the highest bit first, and rows
    /// begin with a byte.
    fn unpack(&self, bytes: &[u8]) -> Vec<u16> {
        if self.bits == 16 {
            let one = if self.big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
            return bytes.chunks_exact(2).map(|b| one([b[0], b[1]])).collect();
        }
        let a_row = self.chunk_width * self.samples_per_pixel;
        let mut samples = Vec::with_capacity(bytes.len() * 8 / self.bits as usize);
        for row in bytes.chunks_exact(self.bytes_of_row()) {
            let (mut word, mut held, mut rest) = (0_u32, 0, row.iter());
            for _ in 0..a_row {
                while held < self.bits {
                    word = word << 8 | u32::from(*rest.next().unwrap_or(&0));
                    held += 8;
                }
                held -= self.bits;
                samples.push((word >> held & ((1 << self.bits) - 1)) as u16);
            }
        }
        samples
    }
}

fn compression(picture: &Directory) -> Result<Compression, Unreadable> {
    match picture.whole_of(Tag::COMPRESSION)?.unwrap_or(1) {
        1 => Ok(Compression::None),
        8 | 32_946 => Ok(Compression::Deflate),
        7 => Ok(Compression::LosslessJpeg),
        34_892 | 6 => Err(Unreadable::Jpeg),
        other => {
            let allowed = "allowed are 1 (none), 7 (lossless JPEG), 8 (deflate): convert with a DNG converter or `dcraw -E -4 -T`";
            Err(Unreadable::tag(Tag::COMPRESSION.name, other, allowed))
        }
    }
}

fn differences(picture: &Directory, compression: Compression, bits: u32) -> Result<bool, Unreadable> {
    match picture.whole_of(Tag::PREDICTOR)?.unwrap_or(1) {
        2 if compression == Compression::Deflate && bits == 16 => Ok(true),
        // Without compression the tag means nothing.
        2 if compression != Compression::Deflate => Ok(false),
        1 => Ok(false),
        other => Err(Unreadable::tag(Tag::PREDICTOR.name, other, "allowed are 1 and, with 16 bits, 2")),
    }
}

fn stored<'a>(bytes: Bytes<'a>, picture: &Directory<'a>, tiled: bool) -> Result<Vec<&'a [u8]>, Unreadable> {
    let (offsets, lengths, what) = if tiled {
        (Tag::TILE_OFFSETS, Tag::TILE_BYTES, "a tile")
    } else {
        (Tag::STRIP_OFFSETS, Tag::STRIP_BYTES, "a strip")
    };
    let (from, length) = (picture.whole(offsets)?, picture.whole(lengths)?);
    if from.is_empty() || from.len() != length.len() {
        let given = format!("{} places and {} lengths", from.len(), length.len());
        return Err(Unreadable::tag(offsets.name, given, "one of each is needed for every strip or tile"));
    }
    from.iter().zip(&length).map(|(from, length)| bytes.slice(what, *from, *length)).collect()
}
