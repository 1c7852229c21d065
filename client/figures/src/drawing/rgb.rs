//! Colours that are distinguishable with colour vision deficiencies.

use std::fmt;

/// An sRGB colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Rgb(pub(crate) u8, pub(crate) u8, pub(crate) u8);

impl Rgb {
    pub(crate) const INK: Self = Self(0x22, 0x22, 0x22);
    pub(crate) const FAINT_INK: Self = Self(0x66, 0x66, 0x66);
    pub(crate) const AXIS: Self = Self(0x55, 0x55, 0x55);
    pub(crate) const RULE: Self = Self(0xe8, 0xe8, 0xe8);
    pub(crate) const GREY: Self = Self(0x9c, 0x9c, 0x9c);
    pub(crate) const NO_DATA: Self = Self(0xdd, 0xdd, 0xdd);
    pub(crate) const WHITE: Self = Self(0xff, 0xff, 0xff);

    // Okabe and Ito, "Color Universal Design", 2008.
    pub(crate) const ORANGE: Self = Self(0xe6, 0x9f, 0x00);
    pub(crate) const SKY_BLUE: Self = Self(0x56, 0xb4, 0xe9);
    pub(crate) const GREEN: Self = Self(0x00, 0x9e, 0x73);
    pub(crate) const BLUE: Self = Self(0x00, 0x72, 0xb2);
    pub(crate) const VERMILLION: Self = Self(0xd5, 0x5e, 0x00);
    pub(crate) const PURPLE: Self = Self(0xcc, 0x79, 0xa7);

    /// Viridis, dark for 0 and bright for 1; values outside are clamped.
    pub(crate) fn viridis(t: f64) -> Self {
        let position = t.clamp(0.0, 1.0) * 255.0;
        let i = ((position / 16.0) as usize).min(VIRIDIS.len() - 2);
        let start = 16.0 * i as f64;
        let part = (position - start) / ((start + 16.0).min(255.0) - start);
        let (a, b) = (VIRIDIS[i], VIRIDIS[i + 1]);
        let mix = |a: u8, b: u8| (f64::from(a) + part * (f64::from(b) - f64::from(a))).round() as u8;
        Self(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2))
    }

    /// A pale tint of this hue, for areas below curves.
    pub(crate) fn tint(self) -> Self {
        let pale = |part: u8| (255.0 - 0.22 * (255.0 - f64::from(part))).round() as u8;
        Self(pale(self.0), pale(self.1), pale(self.2))
    }
}

impl fmt::Display for Rgb {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "#{:02x}{:02x}{:02x}", self.0, self.1, self.2)
    }
}

/// Entries 0, 16, 32, … 240 and 255 of matplotlib's table of 256 (Smith and van der Walt, CC0).
const VIRIDIS: [Rgb; 17] = [
    Rgb(68, 1, 84),
    Rgb(72, 24, 106),
    Rgb(71, 45, 123),
    Rgb(66, 64, 134),
    Rgb(59, 82, 139),
    Rgb(51, 99, 141),
    Rgb(44, 114, 142),
    Rgb(38, 130, 142),
    Rgb(33, 145, 140),
    Rgb(31, 160, 136),
    Rgb(40, 174, 128),
    Rgb(64, 189, 114),
    Rgb(96, 202, 96),
    Rgb(132, 212, 75),
    Rgb(176, 221, 47),
    Rgb(218, 227, 25),
    Rgb(253, 231, 37),
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Viridis is within two levels of the published table, and its luminance increases strictly.
    #[test]
    fn viridis_equals_the_published_table() {
        // Entries 0, 51, 102, 153, 204 and 255 of the table.
        let published =
            [(68, 1, 84), (65, 68, 135), (42, 120, 142), (34, 168, 132), (122, 209, 81), (253, 231, 37)];
        for (i, (r, g, b)) in published.into_iter().enumerate() {
            let Rgb(drawn_r, drawn_g, drawn_b) = Rgb::viridis(i as f64 / 5.0);
            let differences =
                [(r, drawn_r), (g, drawn_g), (b, drawn_b)].map(|(a, b): (u8, u8)| a.abs_diff(b));
            assert!(differences.iter().all(|&difference| difference <= 2), "{i}: {differences:?}");
        }
        assert_eq!((Rgb::viridis(-1.0), Rgb::viridis(2.0)), (Rgb(68, 1, 84), Rgb(253, 231, 37)));
        let luminance = |i: i32| {
            let Rgb(r, g, b) = Rgb::viridis(f64::from(i) / 50.0);
            0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
        };
        assert!((0..50).all(|i| luminance(i) < luminance(i + 1)));
    }
}
