//! Writes photographs as DNG, with deflate, horizontal differencing, and the EXIF tags that `farmctl capture` reads.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use optics_capture::{Frame, Pattern, Photo};

const SHORT: u16 = 3;
const LONG: u16 = 4;
const RATIONAL: u16 = 5;

/// The bytes of the file.
///
/// A channel of its own is LinearRaw with one sample a pixel, as monochrome cameras write it.
///
/// # Panics
/// If the photograph has three colours in each pixel.
#[must_use]
pub fn dng(photo: &Photo) -> Vec<u8> {
    let (photometric, colours) = match photo.frame.pattern() {
        Pattern::Bayer(colours) => (32_803, Some(colours)),
        Pattern::One(_) => (34_892, None),
        Pattern::Rgb => panic!("a DNG of one sample a pixel"),
    };
    let strip = strip(&photo.frame);
    let (width, height) = (photo.frame.width() as u32, photo.frame.height() as u32);
    let longs = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let shorts = |values: &[u16]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let mut tags = vec![
        (254, LONG, longs(&[0])),
        (256, LONG, longs(&[width])),
        (257, LONG, longs(&[height])),
        (258, SHORT, shorts(&[16])),
        (259, SHORT, shorts(&[8])),
        (262, SHORT, shorts(&[photometric])),
        (271, 2, b"Made\0".to_vec()),
        (272, 2, b"Made M1\0".to_vec()),
        (273, LONG, longs(&[8])),
        (277, SHORT, shorts(&[1])),
        (278, LONG, longs(&[height])),
        (279, LONG, longs(&[strip.len() as u32])),
        (317, SHORT, shorts(&[2])),
        (50_706, 1, vec![1, 4, 0, 0]),
        (50_707, 1, vec![1, 3, 0, 0]),
        (50_708, 2, b"Made M1\0".to_vec()),
    ];
    if let Some(colours) = colours {
        tags.push((33_421, SHORT, shorts(&[2, 2])));
        tags.push((33_422, 1, colours.map(|c| c.index() as u8).to_vec()));
    }
    if let Some(seconds) = photo.seconds {
        tags.push((306, 2, time(seconds).into_bytes()));
    }
    if let Some(exposure) = photo.exposure {
        tags.push((33_434, RATIONAL, longs(&[1, (1.0 / exposure.time_s).round() as u32])));
        tags.extend(exposure.f_number.map(|n| (33_437, RATIONAL, longs(&[(10.0 * n) as u32, 10]))));
        tags.extend(exposure.iso.map(|iso| (34_855, SHORT, shorts(&[iso as u16]))));
    }
    tags.extend(photo.levels.black.map(|levels| (50_714, LONG, longs(&[levels[0] as u32]))));
    tags.extend(photo.levels.white.map(|white| (50_717, LONG, longs(&[white[0] as u32]))));
    tags.sort_by_key(|tag| tag.0);
    file(&strip, &tags)
}

fn strip(frame: &Frame) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    for row in frame.samples().chunks_exact(frame.width()) {
        let before = [0].into_iter().chain(row.iter().copied());
        let differences = row.iter().zip(before).flat_map(|(v, before)| v.wrapping_sub(before).to_le_bytes());
        encoder.write_all(&differences.collect::<Vec<_>>()).expect("memory takes it");
    }
    encoder.finish().expect("memory takes it")
}

/// Seconds of a day in November.
fn time(seconds: f64) -> String {
    let s = seconds as u32;
    format!("2026:11:21 {:02}:{:02}:{:02}\0", 8 + s / 3600, s / 60 % 60, s % 60)
}

fn file(strip: &[u8], tags: &[(u16, u16, Vec<u8>)]) -> Vec<u8> {
    let directory = 8 + strip.len().next_multiple_of(2);
    let mut file = b"II\x2a\0".to_vec();
    file.extend((directory as u32).to_le_bytes());
    file.extend(strip);
    file.resize(directory, 0);
    file.extend((tags.len() as u16).to_le_bytes());
    let mut beyond: Vec<u8> = Vec::new();
    for (tag, kind, bytes) in tags {
        let size = [0, 1, 1, 2, 4, 8][usize::from(*kind)];
        file.extend(tag.to_le_bytes().into_iter().chain(kind.to_le_bytes()));
        file.extend(((bytes.len() / size) as u32).to_le_bytes());
        if bytes.len() <= 4 {
            file.extend(bytes.iter().copied().chain([0; 4]).take(4));
        } else {
            let at = directory + 2 + 12 * tags.len() + 4 + beyond.len();
            file.extend((at as u32).to_le_bytes());
            beyond.extend(bytes);
        }
    }
    file.extend([0; 4]);
    file.extend(beyond);
    file
}
