//! Tests of truncated files, and of the orientation of pictures.

use super::*;

/// A lossless JPEG of samples with 16 bits.
pub(super) fn lossless(samples: &[u16], width: usize, components: usize) -> Vec<u8> {
    lossless_of(16, samples, width, components)
}

/// A lossless JPEG with predictor 1. Sizes of differences up to 3 bits have codes of three bits, others of five.
pub(super) fn lossless_of(precision: u8, samples: &[u16], width: usize, components: usize) -> Vec<u8> {
    let row = width * components;
    let mut bits = String::new();
    for (at, sample) in samples.iter().enumerate() {
        let prediction = match (at % row < components, at < row) {
            (true, true) => 1 << (precision - 1),
            (true, false) => samples[at - row],
            _ => samples[at - components],
        };
        let difference = i32::from(sample.wrapping_sub(prediction) as i16);
        let size = 32 - difference.unsigned_abs().leading_zeros();
        let coded = if difference < 0 { difference + (1 << size) - 1 } else { difference };
        bits += &if size < 4 { format!("{size:03b}") } else { format!("{:05b}", 12 + size) };
        if (1..16).contains(&size) {
            bits += &format!("{coded:0w$b}", w = size as usize);
        }
    }
    let mut jpeg = [&[0xff, 0xd8, 0xff, 0xc4, 0, 36, 0, 0, 0, 4, 0, 13][..], &[0; 11]].concat();
    jpeg.extend(0..17);
    let [high, low] = (width as u16).to_be_bytes();
    let [rows_high, rows_low] = ((samples.len() / row) as u16).to_be_bytes();
    jpeg.extend([0xff, 0xc3, 0, 8 + 3 * components as u8, precision, rows_high, rows_low, high, low]);
    jpeg.push(components as u8);
    jpeg.extend((0..components as u8).flat_map(|i| [i, 0x11, 0]));
    jpeg.extend([0xff, 0xda, 0, 6 + 2 * components as u8, components as u8]);
    jpeg.extend((0..components as u8).flat_map(|i| [i, 0]));
    jpeg.extend([1, 0, 0]);
    for byte in packed(&bits, b'1') {
        jpeg.push(byte);
        jpeg.extend((byte == 0xff).then_some(0));
    }
    jpeg.extend([0xff, 0xd9]);
    jpeg
}

/// Irregular numbers that stand for noise.
pub(super) fn noise(count: usize) -> Vec<u16> {
    (0..count as u32).map(|i| 1000 + (i.wrapping_mul(2_654_435_761) >> 23) as u16).collect()
}

/// Lossless JPEG data that end early are refused with the rows that are missing.
#[test]
fn truncated_jpeg_is_refused_with_its_rows() {
    let samples = noise(40 * 30);
    let jpeg = lossless(&samples, 20, 2);
    let whole = Maker { width: 40, height: 30, strip: jpeg.clone(), ..Maker::dng() }.with(259, &[7]);
    assert_eq!(whole.decode().unwrap().samples, samples);
    let half = jpeg.len() / 2;
    let ends = [&jpeg[..half], &[0xff, 0xd9]].concat();
    let hole = [&jpeg[..half], &vec![0; jpeg.len() - half][..]].concat();
    for (strip, what) in [(jpeg[..half].to_vec(), "cut"), (ends, "end marker"), (hole, "zeros")] {
        let refused = Maker { strip, ..whole.clone() }.refused();
        let message = "the picture ends early, as after an interrupted copy: 14 of its 30 rows are there";
        assert!(refused.starts_with(message), "{what}: {refused}");
    }
    // The second of two strips.
    let strip = [&lossless(&samples[..800], 40, 1)[..], &lossless(&samples[800..], 40, 1)].concat();
    let first = lossless(&samples[..800], 40, 1).len() as u32;
    let short = strip.len() as u32 - first - 40;
    let two = Maker { strip, ..whole }.with(278, &[20]).with(273, &[8, 8 + first]);
    assert_eq!(two.clone().with(279, &[first, short + 40]).decode().unwrap().samples, samples);
    let refused = two.with(279, &[first, short]).refused();
    assert!(refused.contains(": 29 of its 30 rows are there"), "{refused}");
}

/// A JPEG of three restart intervals, a row each, is refused if a restart marker is missing.
#[test]
fn missing_restart_marker_is_refused() {
    let samples = noise(3 * 8);
    let mut parts = samples.chunks(8).map(|row| lossless(row, 8, 1));
    let head = |part: &[u8]| part.windows(2).position(|w| w == [0xff, 0xda]).unwrap();
    let mut jpeg = parts.next().unwrap();
    let at = head(&jpeg);
    let height = jpeg.windows(2).position(|w| w == [0xff, 0xc3]).unwrap() + 6;
    jpeg[height] = 3;
    jpeg.truncate(jpeg.len() - 2);
    for (i, part) in (0_u8..).zip(parts) {
        jpeg.extend([0xff, 0xd0 + i]);
        jpeg.extend(&part[at + 10..part.len() - 2]);
    }
    jpeg.extend([0xff, 0xd9]);
    jpeg.splice(at..at, [0xff, 0xdd, 0, 4, 0, 8]);
    let maker = Maker { width: 8, height: 3, ..Maker::dng() }.with(259, &[7]);
    let decoded = Maker { strip: jpeg.clone(), ..maker.clone() }.decode().unwrap();
    assert_eq!(decoded.samples, samples);
    let marker = jpeg.windows(2).position(|w| w == [0xff, 0xd0]).unwrap();
    let without = Maker { strip: [&jpeg[..marker], &jpeg[marker + 2..]].concat(), ..maker.clone() };
    assert!(without.refused().contains(": 1 of its 3 rows are there"), "{}", without.refused());
    let cut = Maker { strip: jpeg[..marker].to_vec(), ..maker };
    assert!(cut.refused().contains(": 1 of its 3 rows are there"), "{}", cut.refused());
}

/// Rows of zeros at the end are refused, except in a dark frame.
#[test]
fn final_zero_rows_are_refused() {
    let pgm = |samples: &[u16]| {
        let mut bytes = b"P5 40 30 65535\n".to_vec();
        bytes.extend(samples.iter().flat_map(|v| v.to_be_bytes()));
        decode(&bytes).and_then(whole).map_err(|e| e.to_string())
    };
    let mut samples = noise(40 * 30);
    samples[40 * 12..40 * 13].fill(0);
    assert!(pgm(&samples).is_ok(), "a line of dead pixels");
    samples[40 * 17 + 5..].fill(0);
    let refused = pgm(&samples).unwrap_err();
    assert!(refused.starts_with("rows 19 to 30, the last ones, hold nothing but zeros"), "{refused}");
    // A dark shot whose black level was subtracted: half of its noise is cut off, and rows may be all zero.
    let dark: Vec<u16> = noise(40 * 30).iter().map(|v| v.saturating_sub(1256)).collect();
    assert!(pgm(&[&dark[..1160], &[0; 40]].concat()).is_ok());
    assert!(pgm(&[0; 1200]).is_ok());
}

/// The orientation is that of the picture or of the first directory.
#[test]
fn orientation_is_that_of_the_picture() {
    let orientation = |maker: Maker| maker.decode().unwrap().about.orientation.map(|o| o.to_string());
    assert_eq!(orientation(Maker::dng()), None);
    let [upside_down, unknown] = [3, 9].map(|number| orientation(Maker::dng().with(274, &[number])));
    assert_eq!((upside_down.as_deref(), unknown), (Some("3 (turned by 180°)"), None));
}
