//! Reads directories of TIFF files: tags with their values (TIFF 6.0, Sec. 2, and BigTIFF).

use super::unreadable::UnreadablePhotograph;

/// Largest number of values of a tag: a camera's file has a hundred thousand tiles at most.
const MOST_VALUES: u64 = 1 << 20;

/// The bytes of a TIFF file and their byte order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bytes<'a> {
    pub(super) all: &'a [u8],
    pub(super) big_endian: bool,
    /// BigTIFF: offsets and counts have 64 bits.
    big: bool,
}

impl<'a> Bytes<'a> {
    /// `None` if the file does not begin as a TIFF.
    pub(super) fn new(all: &'a [u8]) -> Option<Self> {
        match all {
            [b'I', b'I', 42, 0, ..] => Some(Self { all, big_endian: false, big: false }),
            [b'M', b'M', 0, 42, ..] => Some(Self { all, big_endian: true, big: false }),
            [b'I', b'I', 43, 0, 8, 0, 0, 0, ..] => Some(Self { all, big_endian: false, big: true }),
            [b'M', b'M', 0, 43, 0, 8, 0, 0, ..] => Some(Self { all, big_endian: true, big: true }),
            _ => None,
        }
    }

    pub(super) fn slice(self, what: &str, from: u64, length: u64) -> Result<&'a [u8], UnreadablePhotograph> {
        let to = from.saturating_add(length);
        let has = self.all.len() as u64;
        let cut = || UnreadablePhotograph::Truncated { what: what.to_owned(), from, to, has };
        if to > has {
            return Err(cut());
        }
        self.all.get(from as usize..to as usize).ok_or_else(cut)
    }

    fn u16(self, what: &str, at: u64) -> Result<u16, UnreadablePhotograph> {
        let bytes = self.slice(what, at, 2)?;
        let bytes = [bytes[0], bytes[1]];
        Ok(if self.big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    }

    fn u32(self, what: &str, at: u64) -> Result<u32, UnreadablePhotograph> {
        let bytes = self.slice(what, at, 4)?;
        let bytes = [bytes[0], bytes[1], bytes[2], bytes[3]];
        Ok(if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    fn u64(self, what: &str, at: u64) -> Result<u64, UnreadablePhotograph> {
        let (first, second) = (self.u32(what, at)?, self.u32(what, at.saturating_add(4))?);
        let (high, low) = if self.big_endian { (first, second) } else { (second, first) };
        Ok(u64::from(high) << 32 | u64::from(low))
    }

    /// An offset or count.
    fn word(self, what: &str, at: u64) -> Result<u64, UnreadablePhotograph> {
        if self.big { self.u64(what, at) } else { self.u32(what, at).map(u64::from) }
    }

    /// Offset of the first directory.
    pub(super) fn first(self) -> Result<u64, UnreadablePhotograph> {
        self.word("the place of the first directory", if self.big { 8 } else { 4 })
    }
}

#[derive(Debug, Clone, Copy)]
struct DirectoryEntry {
    tag: u16,
    kind: u16,
    count: u64,
    /// Offset of the values.
    at: u64,
}

impl DirectoryEntry {
    /// Bytes of a value.
    fn size(self) -> u64 {
        match self.kind {
            3 | 8 => 2,
            4 | 9 | 11 | 13 => 4,
            5 | 10 | 12 | 16..=18 => 8,
            _ => 1,
        }
    }

    fn bytes(self) -> u64 {
        self.size().saturating_mul(self.count)
    }
}

/// One directory: the tags of one picture, or those of EXIF.
#[derive(Debug, Clone)]
pub(super) struct Directory<'a> {
    bytes: Bytes<'a>,
    entries: Vec<DirectoryEntry>,
    /// Offset of the next one; 0 after the last.
    pub(super) next: u64,
}

impl<'a> Directory<'a> {
    pub(super) fn read(bytes: Bytes<'a>, at: u64) -> Result<Self, UnreadablePhotograph> {
        const WHAT: &str = "a directory";
        let (count, head, word) = if bytes.big {
            (bytes.u64(WHAT, at)?.min(u64::from(u16::MAX)), 8, 8)
        } else {
            (u64::from(bytes.u16(WHAT, at)?), 2, 4)
        };
        let (from, step) = (at.saturating_add(head), 4 + 2 * word);
        let mut entries = Vec::new();
        for i in 0..count {
            let at = from.saturating_add(step * i);
            let (tag, kind) = (bytes.u16(WHAT, at)?, bytes.u16(WHAT, at + 2)?);
            let entry = DirectoryEntry { tag, kind, count: bytes.word(WHAT, at + 4)?, at: at + 4 + word };
            let inline = entry.bytes() <= word;
            let place = if inline { entry.at } else { bytes.word(WHAT, entry.at)? };
            entries.push(DirectoryEntry { at: place, ..entry });
        }
        // Some writers omit the end of the last directory.
        let next = bytes.word(WHAT, from.saturating_add(step * count)).unwrap_or(0);
        Ok(Self { bytes, entries, next })
    }

    pub(super) fn has(&self, tag: Tag) -> bool {
        self.entry(tag).is_some()
    }

    fn entry(&self, tag: Tag) -> Option<DirectoryEntry> {
        self.entries.iter().find(|entry| entry.tag == tag.number).copied()
    }

    /// The values of a tag; empty if it is absent.
    pub(super) fn numbers(&self, tag: Tag) -> Result<Vec<f64>, UnreadablePhotograph> {
        let Some(entry) = self.entry(tag) else { return Ok(Vec::new()) };
        if entry.count > MOST_VALUES {
            let allowed = format!("at most {MOST_VALUES} are read");
            return Err(UnreadablePhotograph::tag(tag.name, format_args!("{} values", entry.count), allowed));
        }
        let bytes = self.bytes.slice(tag.name, entry.at, entry.bytes())?;
        let size = entry.size() as usize;
        bytes.chunks_exact(size).map(|value| self.number(tag, entry.kind, value)).collect()
    }

    fn number(&self, tag: Tag, kind: u16, value: &[u8]) -> Result<f64, UnreadablePhotograph> {
        let u32_at = |i: usize| {
            let b = [value[i], value[i + 1], value[i + 2], value[i + 3]];
            if self.bytes.big_endian { u32::from_be_bytes(b) } else { u32::from_le_bytes(b) }
        };
        let u64_at = |i: usize| {
            let (first, second) = (u64::from(u32_at(i)), u64::from(u32_at(i + 4)));
            let (high, low) = if self.bytes.big_endian { (first, second) } else { (second, first) };
            high << 32 | low
        };
        let u16_at =
            |b: [u8; 2]| if self.bytes.big_endian { u16::from_be_bytes(b) } else { u16::from_le_bytes(b) };
        Ok(match kind {
            1 | 7 => f64::from(value[0]),
            6 => f64::from(value[0] as i8),
            3 => f64::from(u16_at([value[0], value[1]])),
            8 => f64::from(u16_at([value[0], value[1]]) as i16),
            4 | 13 => f64::from(u32_at(0)),
            9 => f64::from(u32_at(0) as i32),
            5 => f64::from(u32_at(0)) / f64::from(u32_at(4)),
            10 => f64::from(u32_at(0) as i32) / f64::from(u32_at(4) as i32),
            11 => f64::from(f32::from_bits(u32_at(0))),
            12 => f64::from_bits(u64_at(0)),
            16 | 18 => u64_at(0) as f64,
            17 => u64_at(0) as i64 as f64,
            _ => {
                return Err(UnreadablePhotograph::tag(
                    tag.name,
                    format_args!("type {kind}"),
                    "must be numbers",
                ));
            }
        })
    }

    /// The first value, if it is a number.
    pub(super) fn number_of(&self, tag: Tag) -> Result<Option<f64>, UnreadablePhotograph> {
        Ok(self.numbers(tag)?.first().copied().filter(|value| value.is_finite()))
    }

    /// Values that must be whole numbers, such as sizes and offsets.
    pub(super) fn whole(&self, tag: Tag) -> Result<Vec<u64>, UnreadablePhotograph> {
        let whole = |value: f64| {
            let sound = value >= 0.0 && value.fract() == 0.0;
            if sound {
                Ok(value as u64)
            } else {
                Err(UnreadablePhotograph::tag(tag.name, value, "must be whole numbers"))
            }
        };
        self.numbers(tag)?.into_iter().map(whole).collect()
    }

    pub(super) fn whole_of(&self, tag: Tag) -> Result<Option<u64>, UnreadablePhotograph> {
        Ok(self.whole(tag)?.first().copied())
    }

    pub(super) fn needed(&self, tag: Tag) -> Result<u64, UnreadablePhotograph> {
        self.whole_of(tag)?.ok_or_else(|| UnreadablePhotograph::missing(tag.name, "every picture has it"))
    }

    /// A text without the zero at its end; `None` if it is empty.
    pub(super) fn text(&self, tag: Tag) -> Option<String> {
        let bytes = self.raw(tag)?;
        let text = String::from_utf8_lossy(bytes);
        let text: String = text.trim_end_matches('\0').chars().filter(|c| !c.is_control()).collect();
        let text = text.trim();
        (!text.is_empty()).then(|| text.to_owned())
    }

    /// The bytes of a tag's values.
    pub(super) fn raw(&self, tag: Tag) -> Option<&'a [u8]> {
        let entry = self.entry(tag)?;
        self.bytes.slice(tag.name, entry.at, entry.bytes()).ok()
    }
}

/// A tag by its number, with its name in the standard.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tag {
    number: u16,
    pub(super) name: &'static str,
}

macro_rules! tags {
    ($($constant:ident = $number:literal $name:literal;)*) => {
        impl Tag {
            $(pub(super) const $constant: Self = Self { number: $number, name: $name };)*
        }
    };
}

tags! {
    SUBFILE_TYPE = 254 "NewSubfileType";
    WIDTH = 256 "ImageWidth";
    HEIGHT = 257 "ImageLength";
    BITS = 258 "BitsPerSample";
    COMPRESSION = 259 "Compression";
    PHOTOMETRIC = 262 "PhotometricInterpretation";
    DESCRIPTION = 270 "ImageDescription";
    MAKE = 271 "Make";
    MODEL = 272 "Model";
    STRIP_OFFSETS = 273 "StripOffsets";
    ORIENTATION = 274 "Orientation";
    SAMPLES = 277 "SamplesPerPixel";
    ROWS_PER_STRIP = 278 "RowsPerStrip";
    STRIP_BYTES = 279 "StripByteCounts";
    PLANAR = 284 "PlanarConfiguration";
    TRANSFER_FUNCTION = 301 "TransferFunction";
    DATE_TIME = 306 "DateTime";
    PREDICTOR = 317 "Predictor";
    TILE_WIDTH = 322 "TileWidth";
    TILE_HEIGHT = 323 "TileLength";
    TILE_OFFSETS = 324 "TileOffsets";
    TILE_BYTES = 325 "TileByteCounts";
    SUB_IFDS = 330 "SubIFDs";
    SAMPLE_FORMAT = 339 "SampleFormat";
    CFA_DIM = 33421 "CFARepeatPatternDim";
    CFA_PATTERN = 33422 "CFAPattern";
    EXPOSURE_TIME = 33434 "ExposureTime";
    F_NUMBER = 33437 "FNumber";
    EXIF = 34665 "ExifIFD";
    ICC = 34675 "ICCProfile";
    ISO = 34855 "ISOSpeedRatings";
    DATE_TIME_ORIGINAL = 36867 "DateTimeOriginal";
    SUBSEC_ORIGINAL = 37521 "SubSecTimeOriginal";
    DNG_VERSION = 50706 "DNGVersion";
    CFA_PLANE_COLOR = 50710 "CFAPlaneColor";
    CFA_LAYOUT = 50711 "CFALayout";
    LINEARIZATION = 50712 "LinearizationTable";
    BLACK_DIM = 50713 "BlackLevelRepeatDim";
    BLACK = 50714 "BlackLevel";
    BLACK_DELTA_H = 50715 "BlackLevelDeltaH";
    BLACK_DELTA_V = 50716 "BlackLevelDeltaV";
    WHITE = 50717 "WhiteLevel";
    ACTIVE_AREA = 50829 "ActiveArea";
    MASKED_AREAS = 50830 "MaskedAreas";
    ROW_INTERLEAVE = 50975 "RowInterleaveFactor";
    SUB_TILE = 50974 "SubTileBlockSize";
    COLUMN_INTERLEAVE = 52547 "ColumnInterleaveFactor";
    FILL_ORDER = 266 "FillOrder";
    OPCODES_1 = 51008 "OpcodeList1";
    OPCODES_2 = 51009 "OpcodeList2";
}
