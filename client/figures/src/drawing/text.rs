//! Measures text, and splits it into lines and into indices and exponents.

use skrifa::instance::{LocationRef, Size};
use skrifa::{FontRef, MetadataProvider};

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

    pub(crate) fn width(&self) -> f64 {
        let font = if self.bold { dejavu::sans::bold() } else { dejavu::sans::regular() };
        // An unreadable font is measured as one of average width.
        let Ok(font) = FontRef::new(font) else {
            return 0.62 * self.size * self.content.chars().count() as f64;
        };
        let (characters, metrics) =
            (font.charmap(), font.glyph_metrics(Size::unscaled(), LocationRef::default()));
        let em = f64::from(font.metrics(Size::unscaled(), LocationRef::default()).units_per_em);
        let advance = |c| metrics.advance_width(characters.map(c).unwrap_or_default()).map_or(0.6, f64::from);
        let ems = spans(&self.content).into_iter().map(|(level, part)| {
            let size = if level == Level::Base { 1.0 } else { SCRIPT };
            size * part.chars().map(advance).sum::<f64>() / em
        });
        self.size * ems.sum::<f64>()
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    Base,
    Index,
    Exponent,
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

    #[test]
    fn every_symbol_used_is_in_the_font() {
        let symbols = "σαμλ∇|−±·…×≤→○◇ₜ";
        for font in [dejavu::sans::regular(), dejavu::sans::bold()] {
            let characters = FontRef::new(font).unwrap().charmap();
            assert!(symbols.chars().all(|c| characters.map(c).is_some_and(|glyph| glyph.to_u32() != 0)));
        }
    }
}
