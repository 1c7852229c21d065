use ::png as png_crate;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use proptest::prelude::*;
use std::io::Write as _;

use super::lossless_jpeg::LosslessJpeg;
use super::*;

mod interrupted;
mod pictures;
mod storage;

/// A TIFF of one strip; tests change its tags.
#[derive(Clone)]
pub(crate) struct Maker {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) big_endian: bool,
    pub(crate) strip: Vec<u8>,
    /// Tag, type, values.
    pub(crate) tags: Vec<(u16, u16, Vec<u32>)>,
}

const RGGB: [Colour; 4] = [Colour::Red, Colour::Green, Colour::Green, Colour::Blue];

impl Maker {
    /// A DNG with a mosaic whose samples count up.
    pub(crate) fn dng() -> Self {
        let strip = (0..24_u16).flat_map(|v| (1000 * v).to_le_bytes()).collect();
        let cfa = vec![
            (33421, 3, vec![2, 2]),
            (33422, 1, vec![0, 1, 1, 2]),
            (50706, 1, vec![1, 4, 0, 0]),
            (50714, 3, vec![64]),
            (50717, 4, vec![15_000]),
        ];
        Self { width: 6, height: 4, big_endian: false, strip, tags: cfa }.with(262, &[32_803])
    }

    fn rgb() -> Self {
        let strip = (0..24_u16).flat_map(|v| (1000 * v).to_le_bytes()).collect();
        Self { width: 4, height: 2, big_endian: false, strip, tags: vec![] }.with(262, &[2]).with(277, &[3])
    }

    pub(crate) fn with(mut self, tag: u16, values: &[u32]) -> Self {
        self.tags.retain(|t| t.0 != tag);
        self.tags.push((tag, 4, values.to_vec()));
        self
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let long = |v: u32| if self.big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
        let mut file = if self.big_endian { b"MM\0\x2a".to_vec() } else { b"II\x2a\0".to_vec() };
        let directory = 8 + self.strip.len() + self.strip.len() % 2;
        file.extend(long(directory as u32));
        file.extend(&self.strip);
        file.resize(directory, 0);
        file.extend(self.directory(directory));
        file
    }

    /// The bytes of a directory at this offset in the file, without a next one.
    fn directory(&self, directory: usize) -> Vec<u8> {
        let short = |v: u16| if self.big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
        let long = |v: u32| if self.big_endian { v.to_be_bytes() } else { v.to_le_bytes() };
        let mut tags = self.tags.clone();
        let usual = [
            (256, vec![self.width]),
            (257, vec![self.height]),
            (258, vec![16]),
            (273, vec![8]),
            (279, vec![self.strip.len() as u32]),
        ];
        for (tag, values) in usual {
            if !tags.iter().any(|t| t.0 == tag) {
                tags.push((tag, 4, values));
            }
        }
        tags.sort_by_key(|t| t.0);
        let mut file = short(tags.len() as u16).to_vec();
        let mut beyond = Vec::new();
        for (tag, kind, values) in &tags {
            let stored: Vec<u8> = values
                .iter()
                .flat_map(|v| match kind {
                    1 => vec![*v as u8],
                    3 => short(*v as u16).to_vec(),
                    _ => long(*v).to_vec(),
                })
                .collect();
            let count = if *kind == 5 { values.len() / 2 } else { values.len() };
            file.extend(short(*tag).into_iter().chain(short(*kind)).chain(long(count as u32)));
            if stored.len() <= 4 {
                file.extend(stored.iter().copied().chain([0; 4]).take(4));
            } else {
                file.extend(long((directory + 2 + 12 * tags.len() + 4 + beyond.len()) as u32));
                beyond.extend(stored);
            }
        }
        file.extend([0; 4]);
        file.extend(beyond);
        file
    }

    fn decode(&self) -> Result<Photograph, UnreadablePhotograph> {
        decode(&self.bytes())
    }

    fn refused(&self) -> String {
        self.decode().unwrap_err().to_string()
    }
}

fn counting() -> Vec<u16> {
    (0..24).map(|v| 1000 * v).collect()
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A DNG file gives its samples, its levels and its exposure.
#[test]
fn dng_gives_samples_levels_and_exposure() {
    let mut dng = Maker::dng().with(34_855, &[100]);
    dng.tags.push((33_434, 5, vec![1, 20]));
    let photograph = dng.decode().unwrap();
    assert_eq!((photograph.width, photograph.height), (6, 4));
    assert_eq!(photograph.layout, SampleLayout::Mosaic(Some(RGGB)));
    assert_eq!(photograph.samples, counting());
    assert_eq!((photograph.black, photograph.white), (Some([64.0; 4]), Some([15_000.0; 4])));
    let about = About { exposure_s: Some(0.05), iso: Some(100.0), ..About::default() };
    assert_eq!(photograph.about, about);
}

/// Both byte orders, deflate and horizontal differencing give the same samples.
#[test]
fn all_encodings_decode_to_the_same_samples() {
    let mut big = Maker::dng();
    big.big_endian = true;
    big.strip = counting().iter().flat_map(|v| v.to_be_bytes()).collect();
    let mut packed = Maker::dng().with(259, &[8]);
    packed.strip = deflated(&packed.strip);
    let mut differences = Maker::dng().with(259, &[8]).with(317, &[2]);
    let rows = counting();
    let stored = rows.chunks(6).flat_map(|row| {
        (0..6).map(|i| if i == 0 { row[0] } else { row[i].wrapping_sub(row[i - 1]) }).collect::<Vec<_>>()
    });
    differences.strip = deflated(&stored.flat_map(u16::to_le_bytes).collect::<Vec<_>>());
    for (maker, what) in [(big, "big"), (packed, "deflate"), (differences, "differences")] {
        assert_eq!(maker.decode().unwrap().samples, counting(), "{what}");
    }
}

/// Bits in bytes, the highest first, filled up with this digit.
fn packed(bits: &str, fill: u8) -> Vec<u8> {
    let byte =
        |bits: &[u8]| bits.iter().chain(&[fill; 8]).take(8).fold(0, |sum, bit| sum << 1 | (bit - b'0'));
    bits.as_bytes().chunks(8).map(byte).collect()
}

/// Packed samples of 10, 12 and 14 bits have the highest bit first.
#[test]
fn packed_samples_have_the_highest_bit_first() {
    for bits in [10, 12, 14] {
        let values: Vec<u16> = (0..24_u32).map(|v| (v * 611 % (1 << bits)) as u16).collect();
        let row = |row: &[u16]| row.iter().map(|v| format!("{v:0bits$b}")).collect::<String>();
        let strip = values.chunks(6).flat_map(|r| packed(&row(r), b'0')).collect();
        let maker = Maker { strip, ..Maker::dng() }.with(258, &[bits as u32]);
        assert_eq!(maker.decode().unwrap().samples, values, "{bits}");
    }
}

/// A picture of 3 × 2 pixels with two components of 8 bits is one of 6 × 2 samples.
#[test]
fn lossless_jpeg_gives_the_samples() {
    let samples = [130, 126, 131, 125, 135, 128, 129, 126, 129, 127, 130, 133];
    let strip = interrupted::lossless_of(8, &samples, 3, 2);
    let maker = Maker { width: 6, height: 2, strip, ..Maker::dng() }.with(259, &[7]);
    assert_eq!(maker.decode().unwrap().samples, samples);
}

/// Masked margins are cut off, and companded values are made linear.
#[test]
fn margins_are_cut_and_companding_undone() {
    let maker = Maker::dng().with(50_829, &[1, 2, 3, 6]);
    let photograph = maker.decode().unwrap();
    assert_eq!((photograph.width, photograph.height), (4, 2));
    assert_eq!(photograph.samples, [8, 9, 10, 11, 14, 15, 16, 17].map(|v| 1000 * v));
    let mut table = Maker::dng().with(50_712, &[0, 10, 40]);
    table.strip = (0..24_u16).flat_map(|v| (v % 4).to_le_bytes()).collect();
    assert_eq!(table.decode().unwrap().samples[..5], [0, 10, 40, 40, 0]);
    let refused = Maker::dng().with(50_829, &[0, 0, 5, 6]).refused();
    assert_eq!(refused, "tag ActiveArea = [0, 0, 5, 6] is not valid: it must lie within 6 × 4 pixels");
}

/// A mosaic of 46 × 40 pixels; its six left columns receive no light, and some of them are defective.
fn with_masked_margin(light_in_margin: u16) -> Maker {
    with_margin(|_| light_in_margin)
}

/// Likewise, with light in each column of the margin.
fn with_margin(light: impl Fn(u16) -> u16) -> Maker {
    let sample = |i: u16| -> u16 {
        let (x, y) = (i % 46, i / 46);
        match (x, y) {
            (0..6, 7) => 9000,
            // The active area begins at column 6: its first column is even.
            (0..6, _) => 500 + 10 * (y % 2) + x % 2 + light(x),
            _ => 5000,
        }
    };
    let strip = (0..46 * 40_u16).flat_map(|i| sample(i).to_le_bytes()).collect();
    let maker = Maker { width: 46, height: 40, strip, ..Maker::dng() };
    maker.with(50_714, &[505]).with(50_829, &[0, 6, 40, 46]).with(50_830, &[0, 0, 40, 6])
}

/// Masked margins give the black level, unless they are too small or light has reached them.
#[test]
fn masked_margins_give_the_black_level() {
    let black = |maker: &Maker| maker.decode().unwrap().black.unwrap();
    // 60 samples per position are too few to estimate it; 300 are enough.
    assert_eq!(black(&with_masked_margin(0)), [505.0; 4]);
    let tall_margin = |one: Maker| {
        Maker { height: 200, strip: one.strip.repeat(5), ..one.clone() }
            .with(50_829, &[0, 6, 200, 46])
            .with(50_830, &[0, 0, 200, 6])
    };
    let tall = |light: u16| tall_margin(with_masked_margin(light));
    assert_eq!(black(&tall(0)), [500.0, 501.0, 510.0, 511.0]);
    assert_eq!(black(&tall(1000)), [505.0; 4], "light fell on the margin");
    assert_eq!(black(&tall_margin(with_margin(|x| 20 * x))), [505.0; 4], "light leaks into the margin");
    let refused = tall(0).with(50_830, &[0, 0, 205, 6]).refused();
    assert!(refused.contains("MaskedAreas") && refused.contains("within 46 × 200 pixels"), "{refused}");
}

/// Tags that change what samples mean are named, unless they leave them as they are.
#[test]
fn tags_that_change_samples_are_named() {
    // A list of one operation: its number, version, flags, and eight bytes of data.
    let list = |id: u32| -> Vec<u32> {
        let words = [1, id, 0x0103_0000, 0, 8, 0, 0];
        words.into_iter().flat_map(|word: u32| word.to_be_bytes().map(u32::from)).collect()
    };
    let with_list = |tag: u16, id: u32| {
        let mut maker = Maker::dng();
        maker.tags.push((tag, 1, list(id)));
        maker
    };
    assert!(with_list(51_009, 9).decode().is_ok(), "a gain map is in the flats as well");
    let refused = with_list(51_009, 8).refused();
    assert!(refused.contains("OpcodeList2 = MapPolynomial") && refused.contains("not applied"), "{refused}");
    assert!(with_list(51_008, 7).refused().contains("OpcodeList1 = MapTable"));
    for (tag, name) in
        [(50_975, "RowInterleaveFactor"), (52_547, "ColumnInterleaveFactor"), (266, "FillOrder")]
    {
        assert!(Maker::dng().with(tag, &[1]).decode().is_ok());
        let refused = Maker::dng().with(tag, &[2]).refused();
        assert!(refused.contains(name) && refused.contains("another order"), "{refused}");
    }
    assert!(Maker::dng().with(339, &[3]).refused().contains("whole numbers of 16 bits"));
}

/// Black levels of a mosaic need no dimensions if there are four of them.
#[test]
fn black_levels_need_no_dimensions() {
    let black = |levels: &[u32]| Maker::dng().with(50_714, levels).decode().unwrap().black;
    assert_eq!(black(&[60, 61, 62, 63]), Some([60.0, 61.0, 62.0, 63.0]));
    assert_eq!(black(&[64; 16]), Some([64.0; 4]));
    assert_eq!(black(&[64, 65, 66, 67, 68]), None);
}

fn png(colour: png_crate::ColorType, depth: png_crate::BitDepth, gamma: Option<f32>) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png_crate::Encoder::new(&mut file, 4, 2);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    if let Some(gamma) = gamma {
        encoder.set_source_gamma(png_crate::ScaledFloat::new(gamma));
    }
    let samples: Vec<u8> = counting().repeat(2).iter().flat_map(|v| v.to_be_bytes()).collect();
    let bytes = 8 * colour.samples() * if depth == png_crate::BitDepth::Sixteen { 2 } else { 1 };
    encoder.write_header().unwrap().write_image_data(&samples[..bytes]).unwrap();
    file
}

/// A PNG of 16 bits is read, unless it has a tone curve.
#[test]
fn png_with_a_tone_curve_is_refused() {
    use png_crate::{BitDepth, ColorType};
    let rgb = decode(&png(ColorType::Rgb, BitDepth::Sixteen, None)).unwrap();
    assert_eq!((rgb.layout, rgb.samples), (SampleLayout::Rgb, counting()));
    assert!(decode(&png(ColorType::Grayscale, BitDepth::Sixteen, Some(1.0))).is_ok());
    for (colour, depth, gamma, message) in [
        (ColorType::Rgb, BitDepth::Sixteen, Some(0.45455), "gone through a tone curve (a gAMA chunk of 0.45"),
        (ColorType::Rgb, BitDepth::Eight, None, "8 bits a sample are too few"),
        (ColorType::Rgba, BitDepth::Sixteen, None, "allowed are grey and RGB"),
    ] {
        let refused = decode(&png(colour, depth, gamma)).unwrap_err().to_string();
        assert!(refused.contains(message), "{refused}");
    }
}

/// The message states the reason and the remedy. Huge sizes in the head of a small file are refused before memory is
/// allocated.
#[test]
fn files_without_linear_radiance_are_refused() {
    let (rgb, dng) = (Maker::rgb, Maker::dng);
    let curve: Vec<u32> = (0..256).map(|i: u32| i * i).collect();
    let case = |maker: Maker, message| (maker.bytes(), message);
    for (bytes, message) in [
        case(rgb().with(258, &[8, 8, 8]), "8 bits a sample are too few"),
        case(rgb().with(262, &[6]), "JPEG"),
        case(rgb().with(339, &[3]), "tag SampleFormat"),
        case(
            rgb().with(259, &[32_773]),
            "tag Compression = 32773 (PackBits) is not valid: allowed are 1 (none), 5",
        ),
        case(rgb().with(301, &curve), "the values have gone through a tone curve (its TransferFunction"),
        case(
            dng().with(33_421, &[6, 6]),
            "tag CFARepeatPatternDim = [6, 6] is not valid: allowed are mosaics of 2 × 2",
        ),
        case(
            dng().with(259, &[52_546]),
            "tag Compression = 52546 (JPEG XL of DNG 1.7) is not valid: allowed are 1",
        ),
        case(dng().with(259, &[34_713]), "tag Compression = 34713 (Nikon's own) is not valid"),
        case(
            dng().with(259, &[34_892]),
            "the DNG is compressed with loss, to 8 bits after a tone curve: convert",
        ),
        case(
            Maker { width: 15_000, height: 10_000, ..dng() },
            "194 bytes are said to hold 150000000 samples",
        ),
        case(
            Maker { width: 15_000, height: 10_000, ..dng().with(259, &[7]) },
            "206 bytes are said to hold 150000000 samples",
        ),
        (b"".to_vec(), "the file is empty"),
        (b"\xff\xd8\xff\xe0".to_vec(), "JPEG holds 8 bits after a tone curve"),
        (b"II\x2a\0\x10\0\0\0CR\x02\0".to_vec(), "CR2 files, a camera's own format, are not read"),
        (b"P5 2 2 255\n    ".to_vec(), "8 bits a sample are too few"),
        (b"P5 2 2\n".to_vec(), "the file is damaged: the head has no greatest value"),
        (
            b"P5 2 2 65535\n  ".to_vec(),
            "the file is cut off or damaged: the pixels should be at bytes 13 to 21, the file has 15",
        ),
        (b"P5 200000 2000 65535\n".to_vec(), "200000 × 2000 pixels are not read: allowed are 1 to 150000000"),
        (b"P2 3 2 1023 1 2 3 4".to_vec(), "the file is damaged: 4 of 6 samples are there"),
        (b"P2 1 1 1023 1024".to_vec(), "the file is damaged: a sample is 1024, the greatest is 1023"),
        (b"hello".to_vec(), "the file is no DNG, TIFF, PNG, PGM or PPM"),
        (
            dng().bytes()[..30].to_vec(),
            "the file is cut off or damaged: a directory should be at bytes 56 to 58",
        ),
    ] {
        let error = decode(&bytes).unwrap_err().to_string();
        assert!(error.starts_with(message), "{error}");
    }
}

proptest! {

    /// Any change of a sound file causes an error or gives a photograph with as many samples as it declares, never a
    /// panic.
    #[test]
    fn damaged_files_never_cause_a_panic(
        kind in 0..8_usize,
        changes in prop::collection::vec((0..400_usize, any::<u8>()), 1..6),
        cut in 0..600_usize,
    ) {
        let mut packed = Maker::dng().with(259, &[8]);
        packed.strip = deflated(&packed.strip);
        let mut bytes = match kind {
            0 => Maker::dng().bytes(),
            1 => packed.bytes(),
            2 => Maker::rgb().with(50_829, &[0, 0, 2, 4]).bytes(),
            3 => png(png_crate::ColorType::Rgb, png_crate::BitDepth::Sixteen, Some(1.0)),
            4 => storage::big_tiff(),
            5 => storage::lzw().bytes(),
            6 => b"P2 6 1 65535 1 20 300 4000 50000 6".to_vec(),
            _ => [&b"P5 6 4 65535\n"[..], &[7; 48]].concat(),
        };
        for (at, value) in changes {
            let length = bytes.len();
            bytes[at % length] = value;
        }
        bytes.truncate(cut.max(1));
        if let Ok(photograph) = decode(&bytes) {
            let wanted = photograph.width * photograph.height * photograph.layout.samples_per_pixel();
            prop_assert_eq!(photograph.samples.len(), wanted);
        }
    }

    #[test]
    fn damaged_lossless_jpeg_never_ends_the_program(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let jpeg = interrupted::lossless(&[7; 6], 3, 1);
        let data = jpeg.windows(2).position(|w| w == [0xff, 0xda]).unwrap() + 10;
        for file in [[&jpeg[..data], &bytes].concat(), bytes] {
            let _ = LosslessJpeg::new(&file).and_then(|jpeg| jpeg.decode());
        }
    }

}
