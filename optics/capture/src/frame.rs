//! Photographs as arrays of sample values.
//!
//! Places in a photograph are in pixels of the mosaic: x to the right, y down, the first pixel's centre at (0.5, 0.5).

use std::fmt;
use std::ops::Range;

use optics_model::Invalid;

/// Largest number of samples of a frame: a hundred megapixels in three colours.
pub const MAX_SAMPLES: usize = 300_000_000;

/// Smallest side of a frame, in pixels: a smaller one cannot show a board.
pub const MIN_SIDE: usize = 64;

/// The subject of a column of results: one colour of a camera, or the only channel of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Colour {
    Red,
    Green,
    Blue,
    Mono,
}

impl Colour {
    /// The colours of a camera.
    pub const ALL: [Self; 3] = [Self::Red, Self::Green, Self::Blue];

    /// Its place among the columns of its frame.
    pub fn index(self) -> usize {
        match self {
            Self::Red | Self::Mono => 0,
            Self::Green => 1,
            Self::Blue => 2,
        }
    }

    /// `R`, `G` or `B`: the channel's name in measurements.
    pub fn letter(self) -> &'static str {
        match self {
            Self::Red => "R",
            Self::Green => "G",
            Self::Blue => "B",
            Self::Mono => "mono",
        }
    }
}

impl fmt::Display for Colour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Red => "red",
            Self::Green => "green",
            Self::Blue => "blue",
            Self::Mono => "monochrome",
        })
    }
}

/// Arrangement of samples in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pattern {
    /// One sample per pixel, behind a mosaic of 2 × 2 pixels, given row by row.
    Bayer([Colour; 4]),
    /// Three samples per pixel, interleaved red, green, blue.
    Rgb,
    /// One sample per pixel of one channel: the positions of 2 × 2 pixels that it has, row by row. All four are of a
    /// monochrome camera, fewer of one colour of a mosaic behind a band-pass filter.
    One([bool; 4]),
}

/// Samples that share a filter and an amplifier: one of the four positions of a mosaic, or one of three colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Site {
    pub index: usize,
    /// Position among 2 × 2 pixels, row by row, or number of the colour: its place in [`Levels`].
    pub position: usize,
    pub colour: Colour,
    /// First column and row of these samples, and the step to the next one.
    pub column: usize,
    pub row: usize,
    pub step: usize,
}

/// One photograph as numbers, as decoded.
#[derive(Clone, PartialEq, Eq)]
pub struct Frame {
    width: usize,
    height: usize,
    pattern: Pattern,
    samples: Vec<u16>,
}

/// Rectangle in pixels of the mosaic.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Area {
    pub x: f64,
    pub y: f64,
    pub width: f64,
    pub height: f64,
}

/// Black and white level of a file, where it contains them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Levels {
    /// Black level of each position of the mosaic, row by row (R, G, B and nothing for [`Pattern::Rgb`]).
    pub black: Option<[f64; 4]>,
    /// Number at which the sensor saturates, likewise.
    pub white: Option<[f64; 4]>,
}

/// Exposure of a shot; shots of a session must agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    pub time_s: f64,
    pub f_number: Option<f64>,
    pub iso: Option<f64>,
}

impl fmt::Display for Exposure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} s", self.time_s)?;
        if let Some(n) = self.f_number {
            write!(f, ", f/{n}")?;
        }
        self.iso.map_or(Ok(()), |iso| write!(f, ", ISO {iso}"))
    }
}

/// A frame with the metadata of its file.
#[derive(Debug, Clone, PartialEq)]
pub struct Photo {
    /// Names the photograph in messages.
    pub label: String,
    pub frame: Frame,
    pub levels: Levels,
    /// Time of the shot, from any common start; the drift of the light is interpolated over it.
    pub seconds: Option<f64>,
    pub exposure: Option<Exposure>,
}

impl Frame {
    pub fn new(width: usize, height: usize, pattern: Pattern, samples: Vec<u16>) -> Result<Self, Invalid> {
        for (field, side) in [("width", width), ("height", height)] {
            if side < MIN_SIDE {
                return Err(Invalid::new(field, side, format!("at least {MIN_SIDE} pixels are needed")));
            }
        }
        let planes = if pattern == Pattern::Rgb { 3 } else { 1 };
        let count = width.checked_mul(height).and_then(|n| n.checked_mul(planes));
        let Some(count) = count.filter(|n| *n <= MAX_SAMPLES) else {
            let given = format!("{width} × {height}");
            return Err(Invalid::new("width × height", given, format!("at most {MAX_SAMPLES} samples")));
        };
        if samples.len() != count {
            let allowed = format!("{width} × {height} pixels have {count} samples");
            return Err(Invalid::new("samples", samples.len(), allowed));
        }
        if let Pattern::Bayer(colours) = pattern
            && Colour::ALL.iter().any(|c| !colours.contains(c))
        {
            let given = colours.map(Colour::letter).concat();
            return Err(Invalid::new("pattern", given, "a mosaic holds red, green and blue"));
        }
        if pattern == Pattern::One([false; 4]) {
            return Err(Invalid::new("pattern", "no position", "a channel has at least one of 2 × 2 pixels"));
        }
        Ok(Self { width, height, pattern, samples })
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    pub fn pattern(&self) -> Pattern {
        self.pattern
    }

    pub fn samples(&self) -> &[u16] {
        &self.samples
    }

    pub fn sites(&self) -> Vec<Site> {
        self.pattern.sites()
    }

    /// Its columns of results.
    pub fn columns(&self) -> &'static [Colour] {
        self.pattern.columns()
    }

    /// A value for each column.
    pub(crate) fn each<T>(&self, value: impl FnMut(Colour) -> T) -> Vec<T> {
        self.columns().iter().copied().map(value).collect()
    }

    /// The samples of one column.
    pub(crate) fn sites_of(&self, colour: Colour) -> Vec<Site> {
        self.sites().into_iter().filter(|site| site.colour == colour).collect()
    }

    /// The sample of a site at one of its pixels.
    pub fn at(&self, site: Site, x: usize, y: usize) -> u16 {
        match self.pattern {
            Pattern::Bayer(_) | Pattern::One(_) => self.samples[y * self.width + x],
            Pattern::Rgb => self.samples[(y * self.width + x) * 3 + site.index],
        }
    }

    /// Columns and rows of a site.
    pub(crate) fn extent(&self, site: Site) -> (usize, usize) {
        let count = |side: usize, first: usize| (side - first).div_ceil(site.step);
        (count(self.width, site.column), count(self.height, site.row))
    }
}

impl Site {
    /// Whether the site has samples in a row.
    pub(crate) fn has_row(self, y: usize) -> bool {
        y >= self.row && (y - self.row).is_multiple_of(self.step)
    }

    pub(crate) fn has_column(self, x: usize) -> bool {
        x >= self.column && (x - self.column).is_multiple_of(self.step)
    }

    /// Its pixels within some columns and rows, every `skip`th in both directions.
    pub fn pixels(
        self,
        columns: Range<usize>,
        rows: Range<usize>,
        skip: usize,
    ) -> impl Iterator<Item = (usize, usize)> {
        let (left, step) = (self.column_from(columns.start), self.step * skip);
        let row = move |y: usize| (left..columns.end).step_by(step).map(move |x| (x, y));
        (self.row_from(rows.start)..rows.end).step_by(step).flat_map(row)
    }

    /// Its pixel that is nearest to a place in a frame of this size.
    pub(crate) fn nearest(self, [x, y]: [f64; 2], frame: &Frame) -> (usize, usize) {
        let on = |v: f64, first: usize, limit: usize| {
            let steps = ((v - 0.5 - first as f64) / self.step as f64).round().max(0.0) as usize;
            (first + steps * self.step).min(limit - 1 - (limit - 1 - first) % self.step)
        };
        (on(x, self.column, frame.width), on(y, self.row, frame.height))
    }

    /// Its first column from `x` on.
    pub(crate) fn column_from(self, x: usize) -> usize {
        x + (self.column + self.step - x % self.step) % self.step
    }

    pub(crate) fn row_from(self, y: usize) -> usize {
        y + (self.row + self.step - y % self.step) % self.step
    }
}

impl Pattern {
    /// All pixels of a monochrome camera.
    pub const MONOCHROME: Self = Self::One([true; 4]);

    /// One colour of a mosaic.
    pub fn only(colours: [Colour; 4], colour: Colour) -> Self {
        Self::One(colours.map(|of| of == colour))
    }

    pub fn sites(self) -> Vec<Site> {
        match self {
            Self::Bayer(colours) => positions(|i| Some(colours[i])),
            Self::One(used) => positions(|i| used[i].then_some(Colour::Mono)),
            Self::Rgb => Colour::ALL
                .map(|colour| {
                    let index = colour.index();
                    Site { index, position: index, colour, column: 0, row: 0, step: 1 }
                })
                .to_vec(),
        }
    }

    /// The columns of results: red, green and blue, or the only channel.
    pub fn columns(self) -> &'static [Colour] {
        match self {
            Self::Bayer(_) | Self::Rgb => &Colour::ALL,
            Self::One(_) => &[Colour::Mono],
        }
    }

    /// The column in which edges are looked for: green, or the only one.
    pub fn sharpest(self) -> Colour {
        self.columns()[self.columns().len() / 2]
    }
}

/// The sites of those of 2 × 2 pixels that have a colour.
fn positions(colour: impl Fn(usize) -> Option<Colour>) -> Vec<Site> {
    let used = (0..4).filter_map(|position| Some((position, colour(position)?)));
    let site = |(index, (position, colour))| Site {
        index,
        position,
        colour,
        column: position % 2,
        row: position / 2,
        step: 2,
    };
    used.enumerate().map(site).collect()
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Frame {{ {} × {}, {:?} }}", self.width, self.height, self.pattern)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every pixel of a channel is in exactly one of its sites, and no other pixel is; all sites are of its only column.
    #[test]
    fn sites_of_a_channel_divide_its_pixels() {
        let rggb = [Colour::Red, Colour::Green, Colour::Green, Colour::Blue];
        let patterns = [
            (Pattern::MONOCHROME, vec![true; 4]),
            (Pattern::only(rggb, Colour::Red), vec![true, false, false, false]),
            (Pattern::only(rggb, Colour::Green), vec![false, true, true, false]),
        ];
        for (pattern, own) in patterns {
            let sites = pattern.sites();
            for (x, y) in (0..8).flat_map(|y| (0..8).map(move |x| (x, y))) {
                let position = x % 2 + 2 * (y % 2);
                let owners: Vec<&Site> = sites.iter().filter(|s| s.has_column(x) && s.has_row(y)).collect();
                assert_eq!(owners.len(), usize::from(own[position]), "{pattern:?} {x} {y}");
                assert!(owners.iter().all(|site| site.position == position));
            }
            assert!(pattern.columns() == [Colour::Mono] && sites.iter().all(|s| s.colour == Colour::Mono));
            assert!(sites.iter().enumerate().all(|(i, site)| site.index == i));
        }
    }
}
