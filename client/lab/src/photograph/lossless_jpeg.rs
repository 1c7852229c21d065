//! Decodes lossless JPEG, the usual compression of DNG (ITU-T T.81, Annex H): Huffman-coded differences from a
//! prediction.

use super::unreadable::UnreadablePhotograph;

/// Zero bytes at the end of coded data without an end marker are no data if there are at least this many.
const SHORTEST_HOLE: usize = 16;

/// One strip or tile: row by row, the components of a pixel side by side.
#[derive(Debug)]
pub(super) struct LosslessJpeg<'a> {
    head: JpegHead,
    scan: &'a [u8],
}

impl<'a> LosslessJpeg<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self, UnreadablePhotograph> {
        let head = JpegHead::read(bytes)?;
        let scan = without_hole(bytes.get(head.scan..).unwrap_or_default());
        Ok(Self { head, scan })
    }

    pub(super) fn samples(&self) -> usize {
        self.head.width * self.head.height * self.head.components
    }

    /// Samples per row.
    pub(super) fn row(&self) -> usize {
        self.head.width * self.head.components
    }

    pub(super) fn decode(&self) -> Result<Vec<u16>, UnreadablePhotograph> {
        // A sample takes at least one bit.
        if self.samples() > self.scan.len().saturating_mul(8) {
            let (has, wanted) = (self.scan.len(), self.samples());
            return Err(damaged(format!("{has} bytes cannot hold {wanted} samples")));
        }
        self.head.samples(self.scan)
    }
}

/// Coded data without the zeros of an interrupted copy: zeros can be decoded, but sound data do not end in a run of that
/// length.
fn without_hole(scan: &[u8]) -> &[u8] {
    let data = scan.len() - scan.iter().rev().take_while(|b| **b == 0).count();
    let ends = scan[..data].ends_with(&[0xff, 0xd9]);
    if ends || scan.len() - data < SHORTEST_HOLE { scan } else { &scan[..data] }
}

fn damaged(what: impl Into<String>) -> UnreadablePhotograph {
    UnreadablePhotograph::Damaged(what.into())
}

/// A Huffman code: for each pattern of the next 16 bits, the length and the value of the code word that they begin with.
type Code = Vec<(u8, u8)>;

#[derive(Debug, Default)]
struct JpegHead {
    width: usize,
    height: usize,
    components: usize,
    precision: u32,
    predictor: u8,
    shift: u32,
    /// Restart interval in pixels; 0 for none.
    restart: usize,
    codes: [Option<Code>; 4],
    /// Index of the code of each component.
    code_of: Vec<usize>,
    /// Offset of the coded data.
    scan: usize,
}

impl JpegHead {
    fn read(bytes: &[u8]) -> Result<Self, UnreadablePhotograph> {
        let mut head = Self::default();
        if bytes.get(..2) != Some(&[0xff, 0xd8]) {
            return Err(damaged("a strip or tile is no lossless JPEG"));
        }
        let mut at = 2;
        loop {
            let cut = || damaged("a lossless JPEG ends within its head");
            let &[0xff, marker, high, low] = bytes.get(at..at + 4).ok_or_else(cut)? else {
                return Err(damaged("a lossless JPEG has no marker where one should be"));
            };
            let length = usize::from(u16::from_be_bytes([high, low]));
            let body = bytes.get(at + 4..at + 2 + length.max(2)).ok_or_else(cut)?;
            at += 2 + length.max(2);
            match marker {
                0xc3 => head.frame(body)?,
                0xc4 => head.tables(body)?,
                0xdd => head.restart = usize::from(u16::from_be_bytes([byte(body, 0)?, byte(body, 1)?])),
                0xda => {
                    head.scan(body)?;
                    head.scan = at;
                    return Ok(head);
                }
                0xc0..=0xc2 | 0xc5..=0xcf => return Err(UnreadablePhotograph::Jpeg),
                _ => {}
            }
        }
    }

    fn frame(&mut self, body: &[u8]) -> Result<(), UnreadablePhotograph> {
        self.precision = u32::from(byte(body, 0)?);
        let u16_at = |i| Ok(usize::from(u16::from_be_bytes([byte(body, i)?, byte(body, i + 1)?])));
        (self.height, self.width) = (u16_at(1)?, u16_at(3)?);
        self.components = usize::from(byte(body, 5)?);
        let sampled = (0..self.components)
            .try_fold(false, |s, i| Ok::<_, UnreadablePhotograph>(s | (byte(body, 7 + 3 * i)? != 0x11)))?;
        if !(2..=16).contains(&self.precision) || !(1..=4).contains(&self.components) || sampled {
            return Err(damaged("a lossless JPEG with a head that DNG does not allow"));
        }
        if self.width == 0 || self.height == 0 {
            return Err(damaged("a lossless JPEG without pixels"));
        }
        Ok(())
    }

    fn tables(&mut self, mut body: &[u8]) -> Result<(), UnreadablePhotograph> {
        while !body.is_empty() {
            let place = usize::from(byte(body, 0)? & 15);
            let counts = body.get(1..17).ok_or_else(|| damaged("a Huffman table is cut off"))?;
            let values: usize = counts.iter().map(|c| usize::from(*c)).sum();
            let symbols = body.get(17..17 + values).ok_or_else(|| damaged("a Huffman table is cut off"))?;
            *self.codes.get_mut(place).ok_or_else(|| damaged("a fifth Huffman table"))? =
                Some(code(counts, symbols)?);
            body = &body[17 + values..];
        }
        Ok(())
    }

    fn scan(&mut self, body: &[u8]) -> Result<(), UnreadablePhotograph> {
        let components = usize::from(byte(body, 0)?);
        if components != self.components || self.components == 0 {
            return Err(damaged("a lossless JPEG in several scans"));
        }
        for i in 0..components {
            let place = usize::from(byte(body, 2 + 2 * i)? >> 4);
            if !matches!(self.codes.get(place), Some(Some(_))) {
                return Err(damaged("a Huffman table is missing"));
            }
            self.code_of.push(place);
        }
        self.predictor = byte(body, 1 + 2 * components)?;
        self.shift = u32::from(byte(body, 3 + 2 * components)? & 15);
        if !(1..=7).contains(&self.predictor) || self.shift >= self.precision {
            return Err(damaged(format!("a lossless JPEG with predictor {}", self.predictor)));
        }
        Ok(())
    }

    fn samples(&self, scan: &[u8]) -> Result<Vec<u16>, UnreadablePhotograph> {
        let row = self.width * self.components;
        let mut samples = vec![0_u16; row * self.height];
        let mut bits = Bits::new(scan);
        let codes: Vec<&Code> = self.code_of.iter().filter_map(|place| self.codes[*place].as_ref()).collect();
        let start = 1_i32 << (self.precision - self.shift - 1);
        // The first row after a restart is predicted without the row above.
        let mut first_row = 0;
        for pixel in 0..self.width * self.height {
            let (y, x) = (pixel / self.width, pixel % self.width);
            let restarts = self.restart > 0 && pixel > 0 && pixel.is_multiple_of(self.restart);
            if restarts {
                if !bits.restart(pixel / self.restart - 1) {
                    return Err(UnreadablePhotograph::EndsEarly { rows: y, height: self.height });
                }
                first_row = y;
            }
            for (component, code) in codes.iter().enumerate() {
                let at = pixel * self.components + component;
                let left = || i32::from(samples[at - self.components]);
                let above = || i32::from(samples[at - row]);
                let prediction = match (x == 0 || restarts, y == first_row) {
                    (true, true) => start,
                    (true, false) => above(),
                    (false, true) => left(),
                    (false, false) => predict(
                        self.predictor,
                        left(),
                        above(),
                        i32::from(samples[at - row - self.components]),
                    ),
                };
                let difference = bits.difference(code);
                let difference = if bits.is_beyond_end() { Ok(0) } else { difference }?;
                samples[at] = (prediction + difference) as u16;
            }
            if bits.is_beyond_end() {
                return Err(UnreadablePhotograph::EndsEarly { rows: y, height: self.height });
            }
        }
        if self.shift > 0 {
            for sample in &mut samples {
                *sample <<= self.shift;
            }
        }
        Ok(samples)
    }
}

/// Table H.1: a is the sample to the left, b above, c above to the left.
fn predict(predictor: u8, a: i32, b: i32, c: i32) -> i32 {
    match predictor {
        1 => a,
        2 => b,
        3 => c,
        4 => a + b - c,
        5 => a + ((b - c) >> 1),
        6 => b + ((a - c) >> 1),
        _ => (a + b) >> 1,
    }
}

fn byte(body: &[u8], at: usize) -> Result<u8, UnreadablePhotograph> {
    body.get(at).copied().ok_or_else(|| damaged("a lossless JPEG ends within its head"))
}

/// Builds a code of 1 to 16 bits from its values in order of their lengths (Annex C).
fn code(counts: &[u8], values: &[u8]) -> Result<Code, UnreadablePhotograph> {
    let mut table = vec![(0, 0); 1 << 16];
    let (mut next, mut values) = (0_usize, values.iter());
    for (length, count) in (1_u8..).zip(counts) {
        let width = 1 << (16 - length);
        for value in values.by_ref().take(usize::from(*count)) {
            let cells = table
                .get_mut(next..next + width)
                .ok_or_else(|| damaged("a Huffman table has too many codes"))?;
            if *value > 16 {
                return Err(damaged(format!("a difference of {value} bits")));
            }
            cells.fill((length, *value));
            next += width;
        }
    }
    Ok(table)
}

/// Bits of coded data, the highest first; a zero byte after 0xff is stuffing. Beyond the end, zeros are appended for the
/// look-ahead.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    word: u64,
    held: u32,
    /// Number of held bits that lie beyond the end.
    beyond: u32,
}

impl<'a> Bits<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, word: 0, held: 0, beyond: 0 }
    }

    fn fill(&mut self) {
        while self.held <= 48 {
            let byte = match (self.bytes.get(self.at), self.bytes.get(self.at + 1)) {
                (Some(0xff), Some(0)) => {
                    self.at += 2;
                    0xff
                }
                // A marker ends the data.
                (Some(0xff) | None, _) => {
                    self.beyond += 8;
                    0
                }
                (Some(byte), _) => {
                    self.at += 1;
                    *byte
                }
            };
            self.word = self.word << 8 | u64::from(byte);
            self.held += 8;
        }
    }

    fn take(&mut self, count: u32) -> u32 {
        self.held -= count;
        (self.word >> self.held) as u32 & ((1 << count) - 1)
    }

    fn difference(&mut self, code: &Code) -> Result<i32, UnreadablePhotograph> {
        self.fill();
        let (length, size) = code[(self.word >> (self.held - 16)) as usize & 0xffff];
        if length == 0 {
            return Err(damaged("coded data that no Huffman code begins with"));
        }
        self.held -= u32::from(length);
        Ok(match size {
            0 => 0,
            16 => 32_768,
            size => {
                let bits = self.take(u32::from(size)) as i32;
                let half = 1 << (size - 1);
                if bits < half { bits - 2 * half + 1 } else { bits }
            }
        })
    }

    /// Whether more bits were read than exist.
    fn is_beyond_end(&self) -> bool {
        self.held < self.beyond
    }

    /// Continues after the next restart marker; false if it is missing or has another number.
    fn restart(&mut self, number: usize) -> bool {
        (self.word, self.held, self.beyond) = (0, 0, 0);
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let marker = rest.windows(2).position(|pair| pair[0] == 0xff && pair[1] != 0);
        let Some(at) = marker else { return false };
        self.at += at + 2;
        usize::from(rest[at + 1]) == 0xd0 + number % 8
    }
}
