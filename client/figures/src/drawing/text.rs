//! Measures text, splits it into lines and into indices and exponents, and places its glyphs.

use std::sync::LazyLock;

use ttf_parser::{Face, GlyphId};

use super::rgb::Rgb;

/// Sizes in CSS pixels.
pub(crate) const TITLE: f64 = 15.0;
pub(crate) const HEADING: f64 = 12.0;
pub(crate) const LABEL: f64 = 11.0;
pub(crate) const SMALL: f64 = 10.0;
pub(crate) const TICK: f64 = 9.5;

/// Height of indices and exponents relative to the text.
pub(crate) const SCRIPT: f64 = 0.72;

/// A line of text in one style. `σ_t` has a lower index, `10^{−3}` an exponent.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Text {
    pub(crate) content: String,
    pub(crate) size: f64,
    pub(crate) bold: bool,
    pub(crate) colour: Rgb,
    pub(crate) anchor: Anchor,
}

/// The part of a text that is aligned with its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

impl Text {
    pub(crate) fn new(content: impl Into<String>, size: f64) -> Self {
        Self { content: content.into(), size, bold: false, colour: Rgb::INK, anchor: Anchor::Start }
    }

    pub(crate) fn bold(self) -> Self {
        Self { bold: true, ..self }
    }

    pub(crate) fn colour(self, colour: Rgb) -> Self {
        Self { colour, ..self }
    }

    pub(crate) fn anchor(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    /// The width without kerning, which a browser may apply or not.
    pub(crate) fn width(&self) -> f64 {
        let face = face(self.bold);
        let ems = spans(&self.content).into_iter().map(|(level, part)| {
            let units = part.chars().map(|c| advance(face, glyph_id(face, c)));
            level.size_and_drop().0 * units.sum::<f64>() / f64::from(face.units_per_em())
        });
        self.size * ems.sum::<f64>()
    }

    /// The glyphs with their kerning, at their distances from the point where the text is anchored.
    pub(crate) fn glyphs(&self) -> Vec<Glyph> {
        let face = face(self.bold);
        let (mut glyphs, mut end) = (Vec::new(), 0.0);
        for (level, part) in spans(&self.content) {
            let (size, drop) = level.size_and_drop();
            let (size, drop) = (size * self.size, drop * self.size);
            let units = size / f64::from(face.units_per_em());
            let mut before = None;
            for character in part.chars() {
                let id = glyph_id(face, character);
                let left = end + units * before.map_or(0.0, |before| kerning(face, before, id));
                let advance = units * advance(face, id);
                glyphs.push(Glyph { id, character: drawn(character), left, drop, size, advance });
                (before, end) = (Some(id), left + advance);
            }
        }
        let anchor = match self.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => end / 2.0,
            Anchor::End => end,
        };
        for glyph in &mut glyphs {
            glyph.left -= anchor;
        }
        glyphs
    }

    /// The text cut to a width, with an ellipsis if anything is cut off.
    pub(crate) fn fitted(self, width: f64) -> Self {
        if self.width() <= width {
            return self;
        }
        // No visible letter is narrower than a tenth of its height.
        let most = (10.0 * width / self.size).max(0.0) as usize;
        let mut kept: Vec<char> = self.content.chars().take(most).collect();
        while kept.pop().is_some() {
            let content = kept.iter().collect::<String>().trim_end().to_owned() + "…";
            let shorter = Self { content, ..self.clone() };
            if shorter.width() <= width {
                return shorter;
            }
        }
        Self { content: "…".into(), ..self }
    }

    /// Lines no wider than `width`, broken after commas if that suffices, else at spaces.
    pub(crate) fn wrapped(&self, width: f64) -> Vec<Self> {
        let with = |content: &str| Self { content: content.trim().to_owned(), ..self.clone() };
        let phrases = self.content.split_inclusive(", ").flat_map(|phrase| {
            let fits = with(phrase).width() <= width;
            if fits { vec![phrase] } else { phrase.split_inclusive(' ').collect() }
        });
        let mut lines = vec![String::new()];
        for phrase in phrases {
            match lines.last_mut() {
                Some(line) if line.is_empty() || with(&format!("{line}{phrase}")).width() <= width => {
                    line.push_str(phrase);
                }
                _ => lines.push(phrase.to_owned()),
            }
        }
        lines.iter().map(|line| with(line).fitted(width)).collect()
    }
}

/// A glyph at its place along the baseline and below it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Glyph {
    pub(crate) id: GlyphId,
    pub(crate) character: char,
    pub(crate) left: f64,
    pub(crate) drop: f64,
    pub(crate) size: f64,
    pub(crate) advance: f64,
}

/// The font of all texts, DejaVu Sans.
pub(crate) fn face(bold: bool) -> &'static Face<'static> {
    static FACES: LazyLock<[Face<'static>; 2]> = LazyLock::new(|| {
        [dejavu::sans::regular(), dejavu::sans::bold()]
            .map(|font| Face::parse(font, 0).expect("the font is a part of the program"))
    });
    &FACES[usize::from(bold)]
}

/// The glyph of a character, or else the font's box for unknown ones.
fn glyph_id(face: &Face, character: char) -> GlyphId {
    face.glyph_index(drawn(character)).unwrap_or_default()
}

fn advance(face: &Face, id: GlyphId) -> f64 {
    face.glyph_hor_advance(id).map_or(0.0, f64::from)
}

/// The change of the distance of two glyphs, in units of the font.
fn kerning(face: &Face, before: GlyphId, id: GlyphId) -> f64 {
    let tables = face.tables().kern.into_iter().flat_map(|table| table.subtables);
    let found = tables.filter(|table| table.horizontal).find_map(|table| table.glyphs_kerning(before, id));
    found.map_or(0.0, f64::from)
}

/// The character that is drawn: a space for those that XML forbids.
pub(crate) fn drawn(character: char) -> char {
    if character.is_control() || "\u{fffe}\u{ffff}".contains(character) { ' ' } else { character }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Base,
    Index,
    Exponent,
}

impl Level {
    /// Size of the letters and distance below the baseline, relative to the size of the text.
    pub(crate) fn size_and_drop(self) -> (f64, f64) {
        match self {
            Self::Base => (1.0, 0.0),
            Self::Index => (SCRIPT, 0.18),
            Self::Exponent => (SCRIPT, -0.36),
        }
    }
}

/// The parts of a text by their level.
pub(crate) fn spans(content: &str) -> Vec<(Level, &str)> {
    let mut spans = Vec::new();
    let mut rest = content;
    loop {
        let index = rest.find("σ_").map(|at| (at, at + "σ".len(), Level::Index));
        let exponent = rest.find("^{").map(|at| (at, at, Level::Exponent));
        let Some((_, base_end, level)) = [index, exponent].into_iter().flatten().min_by_key(|found| found.0)
        else {
            break;
        };
        let script = &rest[base_end..];
        let (start, end, after) = match level {
            Level::Exponent => match script.find('}') {
                Some(end) => (2, end, end + 1),
                None => break,
            },
            _ => match script.chars().nth(1) {
                Some(c) => (1, 1 + c.len_utf8(), 1 + c.len_utf8()),
                None => break,
            },
        };
        spans.push((Level::Base, &rest[..base_end]));
        spans.push((level, &script[start..end]));
        rest = &script[after..];
    }
    spans.push((Level::Base, rest));
    spans.retain(|(_, part)| !part.is_empty());
    spans
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_and_exponents_are_found() {
        let (base, index, exponent) = (Level::Base, Level::Index, Level::Exponent);
        assert_eq!(spans("σ_t [1/mm]"), [(base, "σ"), (index, "t"), (base, " [1/mm]")]);
        assert_eq!(spans("2·10^{−3} σ_s"), [(base, "2·10"), (exponent, "−3"), (base, " σ"), (index, "s")]);
        assert_eq!(spans("snake_case ^{open"), [(base, "snake_case ^{open")]);
        assert_eq!(spans("σ_"), [(base, "σ_")]);
    }

    /// Lines break after commas before they break elsewhere.
    #[test]
    fn lines_break_after_commas_first() {
        let text = Text::new("σ_t 6.12 ± 0.05, α 0.99912 ± 0.00003", 10.0);
        let lines: Vec<_> = text.wrapped(130.0).into_iter().map(|line| line.content).collect();
        assert_eq!(lines, ["σ_t 6.12 ± 0.05,", "α 0.99912 ± 0.00003"]);
        assert!(text.wrapped(60.0).iter().all(|line| line.width() <= 60.0));
        assert_eq!(text.wrapped(1000.0), [text]);
    }

    #[test]
    fn long_text_ends_in_an_ellipsis() {
        let text = Text::new("a very long name of a channel", 10.0).fitted(60.0);
        assert!(text.content.ends_with('…') && text.width() <= 60.0);
    }

    /// Where a text is anchored, all its glyphs count: with indices, smaller, and with kerning.
    #[test]
    fn glyphs_lie_around_the_anchor() {
        let ends = |anchor| {
            let glyphs = Text::new("AVA σ_t", 10.0).anchor(anchor).glyphs();
            let last = glyphs[glyphs.len() - 1];
            assert_eq!((last.character, last.size, last.drop), ('t', SCRIPT * 10.0, 0.18 * 10.0));
            [glyphs[0].left, last.left + last.advance]
        };
        let [start, width] = ends(Anchor::Start);
        let unkerned = Text::new("AVA σ_t", 10.0).width();
        assert!(start == 0.0 && (0.9 * unkerned..0.99 * unkerned).contains(&width), "{width} of {unkerned}");
        for (anchor, start) in [(Anchor::Middle, -width / 2.0), (Anchor::End, -width)] {
            let [left, right] = ends(anchor);
            assert!((left - start).abs() < 1e-9 && (right - start - width).abs() < 1e-9, "{left} {right}");
        }
    }

    #[test]
    fn every_symbol_used_is_in_the_font() {
        let symbols = "σαμλ∇|−±·…×≤→○◇ₜ";
        for face in [false, true].map(face) {
            assert!(symbols.chars().all(|c| face.glyph_index(c).is_some_and(|glyph| glyph.0 != 0)));
        }
    }
}
