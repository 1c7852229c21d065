//! Tests of stored samples, including variants beyond the specification.

use super::interrupted::{lossless, noise};
use super::*;

const WIDTH: usize = 100;
const HEIGHT: usize = 60;

fn maker() -> Maker {
    Maker { width: WIDTH as u32, height: HEIGHT as u32, ..Maker::dng() }
}

/// A part of the picture; beyond it, the last row and column are repeated.
fn part(samples: &[u16], left: usize, top: usize, width: usize, height: usize) -> Vec<u16> {
    let at = |x: usize, y: usize| samples[y.min(HEIGHT - 1) * WIDTH + x.min(WIDTH - 1)];
    (0..width * height).map(|i| at(left + i % width, top + i / width)).collect()
}

fn little(samples: &[u16]) -> Vec<u8> {
    samples.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Tiles side by side, or strips as high as a tile.
fn chunks(side: (usize, usize), is_tiled: bool, encode: impl Fn(usize, usize) -> Vec<u8>) -> Maker {
    let (mut strip, mut offsets, mut lengths) = (Vec::new(), Vec::new(), Vec::new());
    for top in (0..HEIGHT).step_by(side.1) {
        for left in (0..WIDTH).step_by(side.0) {
            let bytes = encode(left, top);
            offsets.push(8 + strip.len() as u32);
            lengths.push(bytes.len() as u32);
            strip.extend(bytes);
        }
    }
    let maker = Maker { strip, ..maker() };
    if is_tiled {
        let sides = maker.with(322, &[side.0 as u32]).with(323, &[side.1 as u32]);
        sides.with(324, &offsets).with(325, &lengths)
    } else {
        maker.with(278, &[side.1 as u32]).with(273, &offsets).with(279, &lengths)
    }
}

/// The last tiles and strips may be whole or cut to the picture.
#[test]
fn last_tiles_may_be_whole_or_cut() {
    let samples = noise(WIDTH * HEIGHT);
    for side in [(WIDTH, 16), (32, 16), (32, HEIGHT)] {
        let cut = |left: usize, top: usize| (side.0.min(WIDTH - left), side.1.min(HEIGHT - top));
        let whole = |left, top| part(&samples, left, top, side.0, side.1);
        let cropped = |left, top| part(&samples, left, top, cut(left, top).0, cut(left, top).1);
        let rows = |left, top| part(&samples, left, top, side.0, cut(left, top).1);
        let columns = |left, top| part(&samples, left, top, cut(left, top).0, side.1);
        let ways: [&dyn Fn(usize, usize) -> Vec<u16>; 4] = [&whole, &cropped, &rows, &columns];
        for (i, way) in ways.into_iter().enumerate() {
            let height = |left, top, width: usize| way(left, top).len() / width;
            let jpeg = |left, top| {
                let width = if [0, 2].contains(&i) { side.0 } else { cut(left, top).0 };
                assert_eq!(way(left, top).len(), width * height(left, top, width));
                lossless(&way(left, top), width, 1)
            };
            for is_tiled in [true, false] {
                if !is_tiled && side.0 != WIDTH {
                    continue;
                }
                let what = format!("{side:?} {i} {is_tiled}");
                let plain = chunks(side, is_tiled, |left, top| little(&way(left, top)));
                assert_eq!(plain.decode().unwrap().samples, samples, "{what}");
                if !is_tiled {
                    let sizes = plain.with(322, &[WIDTH as u32]).with(323, &[HEIGHT as u32]);
                    assert_eq!(
                        sizes.decode().unwrap().samples,
                        samples,
                        "sizes of tiles are ignored: {what}"
                    );
                }
                let jpeg = chunks(side, is_tiled, jpeg).with(259, &[7]);
                assert_eq!(jpeg.decode().unwrap().samples, samples, "{what}");
            }
        }
    }
    // Some writers arrange rows otherwise: two components, and half as many columns.
    let pairs = chunks((WIDTH, 16), true, |left, top| lossless(&part(&samples, left, top, 100, 16), 50, 2));
    assert_eq!(pairs.with(259, &[7]).decode().unwrap().samples, samples);
}

/// Words of 16 bits are read if the file states fewer bits, as long as the values fit.
#[test]
fn words_may_be_wider_than_their_bits() {
    let samples: Vec<u16> = noise(WIDTH * HEIGHT).iter().map(|v| 10 * v).collect();
    let message = |bits: u32, samples: &[u16]| Maker { strip: little(samples), ..maker() }.with(258, &[bits]);
    assert_eq!(message(14, &samples).decode().unwrap().samples, samples);
    let deflate = Maker { strip: deflated(&little(&samples)), ..maker() }.with(258, &[14]).with(259, &[8]);
    assert_eq!(deflate.decode().unwrap().samples, samples);
    let shifted: Vec<u16> = samples.iter().map(|v| 4 * v).collect();
    let refused = message(14, &shifted).refused();
    let expected = "tag BitsPerSample = 14 with 16 bits stored for each sample is not valid: larger values";
    assert!(refused.starts_with(expected), "{refused}");
}

const BIG: [(u16, u64); 7] = [(256, 6), (257, 4), (258, 16), (262, 1), (273, 16), (279, 48), (274, 6)];

/// The picture of counting samples as BigTIFF.
pub(super) fn big_tiff() -> Vec<u8> {
    big(&BIG, &little(&counting()))
}

pub(super) fn lzw() -> Maker {
    let mut encoder = weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
    let strip = encoder.encode(&little(&counting())).unwrap();
    Maker { strip, ..Maker::dng() }.with(259, &[5])
}

/// A picture with its tags as BigTIFF.
fn big(tags: &[(u16, u64)], strip: &[u8]) -> Vec<u8> {
    let mut file = b"II\x2b\0\x08\0\0\0".to_vec();
    file.extend((16 + strip.len() as u64).to_le_bytes());
    file.extend(strip);
    file.extend((tags.len() as u64).to_le_bytes());
    for (tag, value) in tags {
        file.extend(tag.to_le_bytes().into_iter().chain([16, 0]).chain(1_u64.to_le_bytes()));
        file.extend(value.to_le_bytes());
    }
    file.extend([0; 8]);
    file
}

#[test]
fn big_tiff_and_lzw_are_read() {
    let strip = little(&counting());
    let photograph = decode(&big(&BIG, &strip)).unwrap();
    assert_eq!((photograph.width, photograph.height, photograph.samples), (6, 4, counting()));
    assert_eq!(photograph.about.orientation.unwrap().number(), 6);
    let lost = BIG.map(|(tag, value)| (tag, if tag == 273 { u64::MAX } else { value }));
    let lost = decode(&big(&lost, &strip)).unwrap_err().to_string();
    assert!(lost.starts_with("the file is cut off or damaged: a strip"), "{lost}");
    let maker = lzw();
    let cut = maker.strip[..maker.strip.len() / 2].to_vec();
    assert_eq!(maker.decode().unwrap().samples, counting());
    let refused = Maker { strip: cut, ..maker }.refused();
    assert!(refused.starts_with("the file is damaged: a strip or tile"), "{refused}");
}

/// RGB, linear grey, mosaics without a pattern, and portable maps in bytes and in text.
#[test]
fn pictures_of_all_kinds_are_read() {
    use SampleLayout::{Mosaic, Rgb};
    let grey = |kind| Maker { tags: vec![], ..Maker::dng() }.with(262, &[kind]).bytes();
    let text = b"P2\n# text\n3 2\n65535\n1 2 3\n400 5\n65535\n".to_vec();
    for (bytes, layout, white, samples) in [
        (Maker::rgb().bytes(), Rgb, None, counting()),
        (grey(1), Mosaic(None), None, counting()),
        (grey(34_892), Mosaic(None), None, counting()),
        (b"P5\n# a comment\n2 1\n65535\n\x01\0\x02\x03".to_vec(), Mosaic(None), None, vec![256, 515]),
        (b"P6 1 1 1023\n\0\x01\0\x02\0\x03".to_vec(), Rgb, Some(1023.0), vec![1, 2, 3]),
        (text, Mosaic(None), None, vec![1, 2, 3, 400, 5, 65_535]),
        (b"P3 1 1 1023 7 8 9".to_vec(), Rgb, Some(1023.0), vec![7, 8, 9]),
    ] {
        let found = decode(&bytes).unwrap();
        assert_eq!((found.layout, found.white, found.black), (layout, white.map(|level| [level; 4]), None));
        assert_eq!(found.samples, samples);
    }
}

/// Areas that reach a little beyond the picture are cut to it.
#[test]
fn overlapping_areas_are_cut_to_the_picture() {
    let samples = noise(WIDTH * HEIGHT);
    let maker = Maker { strip: little(&samples), ..maker() };
    let area = |area: [u32; 4]| maker.clone().with(50_829, &area);
    let photograph = area([0, 0, 61, 102]).decode().unwrap();
    assert_eq!((photograph.width, photograph.height), (100, 60));
    let photograph = area([2, 4, 61, 102]).decode().unwrap();
    assert_eq!((photograph.width, photograph.height), (96, 58));
    assert_eq!(photograph.samples[..96], samples[204..300]);
    assert!(area([0, 0, 62, 100]).refused().starts_with("tag ActiveArea"));
    // Empty rectangles are accepted, too.
    for masked in [[0, 0, 61, 102], [0, 0, 0, 0]] {
        let photograph = area([0, 0, 60, 100]).with(50_830, &masked).decode().unwrap();
        assert_eq!(photograph.black, Some([64.0; 4]));
    }
}

#[test]
fn white_level_may_differ_between_channels() {
    let white = |maker: Maker, levels: &[u32]| maker.with(50_717, levels).decode().unwrap().white.unwrap();
    assert_eq!(white(Maker::rgb(), &[1023, 1023, 450]), [1023.0, 1023.0, 450.0, 1023.0]);
    assert_eq!(white(Maker::rgb(), &[300, 1023, 1023]), [300.0, 1023.0, 1023.0, 1023.0]);
    assert_eq!(white(Maker::dng(), &[1, 2, 3, 4]), [1.0, 2.0, 3.0, 4.0]);
    assert_eq!(white(Maker::dng(), &[900, 800]), [800.0; 4]);
}

/// A small file gives no large picture: compressed zeros, tiles far larger than the picture, many tiles at one offset.
#[test]
fn small_files_do_not_become_large_pictures() {
    let zeros = |samples: usize| deflated(&vec![0; 2 * samples]);
    let deflate = || Maker::dng().with(259, &[8]);
    let tiles = |side: u32, offsets: &[u32], lengths: &[u32]| {
        deflate().with(322, &[side]).with(323, &[side]).with(324, offsets).with(325, lengths)
    };
    let zeros_of_a_picture = Maker { width: 8000, height: 8000, strip: zeros(1000), ..deflate() };
    let large_tile = Maker { strip: zeros(100_000), ..tiles(12_000, &[8], &[100]) };
    let strip = zeros(320 * 320);
    let length = strip.len() as u32;
    let one_place = Maker { width: 6400, height: 6400, strip, ..tiles(320, &[8; 400], &[length; 400]) };
    for (maker, samples) in
        [(zeros_of_a_picture, 64_000_000), (large_tile, 144_000_000), (one_place, 6400 * 6400)]
    {
        let bytes = maker.bytes();
        let expected = UnreadablePhotograph::Compressed { file_bytes: bytes.len(), samples };
        assert_eq!(decode(&bytes), Err(expected));
    }
}
