//! Reads photographs as numbers: files of cameras and raw converters, decoded without a change to any sample.
//!
//! Files without linear values of more than 8 bits are refused, with a remedy. Sizes are checked against the file before
//! memory is allocated, so that a damaged file costs no more than a sound one.

mod about;
mod chunks;
mod directory;
mod icc;
mod lossless_jpeg;
mod masked;
mod netpbm;
mod png;
#[cfg(test)]
pub(crate) mod tests;
mod tiff;
mod unreadable;

use std::path::Path;

use anyhow::{Context, Result};
use optics_capture::Colour;

pub use about::{About, Orientation};
pub use unreadable::UnreadablePhotograph;

use crate::bounded_file;

/// Largest number of pixels of a photograph.
pub const MOST_PIXELS: usize = 150_000_000;
/// Largest number of directories of a TIFF that are read; a loop of them ends there.
const MOST_DIRECTORIES: usize = 64;

/// Largest file that is read, in bytes: three samples of 16 bits for each pixel, and some margin.
const LARGEST: u64 = 1_000_000_000;

/// Arrangement of a photograph's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleLayout {
    /// One sample per pixel, its colour by row and column modulo 2; `None` if the file does not state it.
    Mosaic(Option<[Colour; 4]>),
    /// Three samples per pixel.
    Rgb,
}

impl SampleLayout {
    pub fn samples_per_pixel(self) -> usize {
        match self {
            Self::Mosaic(_) => 1,
            Self::Rgb => 3,
        }
    }
}

/// A decoded photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct Photograph {
    pub width: usize,
    pub height: usize,
    pub layout: SampleLayout,
    /// Row by row.
    pub samples: Vec<u16>,
    /// Black level by row and column modulo 2, or by colour.
    pub black: Option<[f64; 4]>,
    /// Level at which the sensor saturates, likewise.
    pub white: Option<[f64; 4]>,
    pub about: About,
}

/// Reads a photograph; the digest is that of the file.
pub fn read(path: &Path) -> Result<(Photograph, blake3::Hash)> {
    let place = || format!("photograph {}", path.display());
    let bytes = bounded_file::read(path, LARGEST).with_context(place)?;
    let digest = blake3::hash(&bytes);
    let photograph = decode(&bytes).and_then(whole).with_context(place)?;
    Ok((photograph, digest))
}

/// Rows of zeros at the end mean an interrupted copy if the share of zeros before them is below this. Shots whose black
/// level is subtracted have many zeros.
const FEW_ZEROS: f64 = 0.1;

/// Refuses photographs that end in rows of exact zeros.
fn whole(photograph: Photograph) -> Result<Photograph, UnreadablePhotograph> {
    let samples = &photograph.samples;
    let row = photograph.width * photograph.layout.samples_per_pixel();
    let there = samples.len() - samples.iter().rev().take_while(|v| **v == 0).count();
    let zeros = samples[..there].iter().filter(|v| **v == 0).count();
    if samples.len() - there < row || zeros as f64 >= FEW_ZEROS * there as f64 {
        return Ok(photograph);
    }
    Err(UnreadablePhotograph::ZeroRows { from: there.div_ceil(row) + 1, to: photograph.height })
}

/// Decodes a file of any known format, recognised by its first bytes.
pub fn decode(bytes: &[u8]) -> Result<Photograph, UnreadablePhotograph> {
    match bytes {
        [] => Err(UnreadablePhotograph::Empty),
        [0xff, 0xd8, ..] => Err(UnreadablePhotograph::Jpeg),
        [0x89, b'P', b'N', b'G', ..] => png::decode(bytes),
        [b'P', b'2' | b'3' | b'5' | b'6', ..] => netpbm::decode(bytes),
        [b'P', b'1' | b'4', ..] => Err(UnreadablePhotograph::EightBit { bits: 1 }),
        // Canon, Olympus, Panasonic, Fujifilm.
        [_, _, _, _, _, _, _, _, b'C', b'R', ..] if tiff::is_tiff(bytes) => {
            Err(UnreadablePhotograph::CamerasOwn("CR2"))
        }
        [_, _, _, _, b'f', b't', b'y', b'p', b'c', b'r', b'x', ..] => {
            Err(UnreadablePhotograph::CamerasOwn("CR3"))
        }
        [b'I', b'I', b'R', b'O' | b'S', ..] => Err(UnreadablePhotograph::CamerasOwn("ORF")),
        [b'I', b'I', b'U', 0, ..] => Err(UnreadablePhotograph::CamerasOwn("RW2")),
        [b'F', b'U', b'J', b'I', b'F', b'I', b'L', b'M', ..] => Err(UnreadablePhotograph::CamerasOwn("RAF")),
        _ if tiff::is_tiff(bytes) => tiff::decode(bytes),
        _ => Err(UnreadablePhotograph::UnknownFormat),
    }
}

/// Largest ratio of the samples' size, two bytes each, to the file's: noise prevents a higher compression. Samples up to
/// `SMALL_BYTES` may exceed it, since programs generate small files.
const MOST_COMPRESSED: u64 = 64;
const SMALL_BYTES: u64 = 64 << 20;

/// Refuses more samples than the file can hold, before memory is allocated.
fn checked_samples(file_bytes: usize, samples: u64) -> Result<(), UnreadablePhotograph> {
    let most = MOST_COMPRESSED.saturating_mul(file_bytes as u64).max(SMALL_BYTES);
    if samples.saturating_mul(2) > most {
        return Err(UnreadablePhotograph::Compressed { file_bytes, samples });
    }
    Ok(())
}

/// Refuses sizes that no photograph has, before memory is allocated.
fn checked_size(width: u64, height: u64) -> Result<(usize, usize), UnreadablePhotograph> {
    let pixels = width.checked_mul(height).filter(|n| (1..=MOST_PIXELS as u64).contains(n));
    match pixels {
        Some(_) => Ok((width as usize, height as usize)),
        None => Err(UnreadablePhotograph::Size { width, height }),
    }
}
