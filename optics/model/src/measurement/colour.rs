//! Names of channels: the three colours, and wavelengths.

/// `R`, `G` or `B` for a name that means one of them in any case: its letter, or the word.
pub fn colour(name: &str) -> Option<&'static str> {
    match name.to_ascii_lowercase().as_str() {
        "r" | "red" => Some("R"),
        "g" | "green" => Some("G"),
        "b" | "blue" => Some("B"),
        _ => None,
    }
}

/// Numbers outside of this range are names of channels, not wavelengths.
const WAVELENGTHS_NM: std::ops::RangeInclusive<f64> = 100.0..=20_000.0;

/// The wavelength in nm for a name that is one, with or without its unit: `550`, `550 nm`.
pub fn wavelength_nm(name: &str) -> Option<f64> {
    let number = name.trim().trim_end_matches("nm").trim_end();
    number.parse().ok().filter(|nm| WAVELENGTHS_NM.contains(nm))
}

#[cfg(test)]
mod tests {
    use super::{colour, wavelength_nm};

    #[test]
    fn wavelengths_are_recognised_with_their_unit() {
        let found = ["550", " 550.5 nm", "550nm", "5", "nm", "R", "550 mm"].map(wavelength_nm);
        assert_eq!(found, [Some(550.0), Some(550.5), Some(550.0), None, None, None, None]);
    }

    /// Letters and words are colours; wavelengths are not.
    #[test]
    fn colour_names_are_recognised_in_any_case() {
        assert_eq!(["r", "Red", "GREEN", "b"].map(colour), [Some("R"), Some("R"), Some("G"), Some("B")]);
        assert_eq!(["450", "mono", "infrared", ""].map(colour), [None; 4]);
    }
}
