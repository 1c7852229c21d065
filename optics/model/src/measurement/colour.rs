//! Names of the three colour channels.

/// `R`, `G` or `B` for a name that means one of them in any case: its letter, or the word.
pub fn colour(name: &str) -> Option<&'static str> {
    match name.to_ascii_lowercase().as_str() {
        "r" | "red" => Some("R"),
        "g" | "green" => Some("G"),
        "b" | "blue" => Some("B"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::colour;

    /// Letters and words are colours; wavelengths are not.
    #[test]
    fn colour_names_are_recognised_in_any_case() {
        assert_eq!(["r", "Red", "GREEN", "b"].map(colour), [Some("R"), Some("R"), Some("G"), Some("B")]);
        assert_eq!(["450", "mono", "infrared", ""].map(colour), [None; 4]);
    }
}
