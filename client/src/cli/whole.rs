//! Parses whole numbers on the command line: `1000000`, `1_000_000`, `1e6`.

/// Parses a whole number with underscores or an exponent.
pub(crate) fn whole_number(text: &str) -> Result<u64, String> {
    let plain = text.trim().replace('_', "");
    let number = plain.parse().ok().or_else(|| plain.parse().ok().and_then(optics_model::whole));
    number.ok_or_else(|| "a whole number is needed, as in 1000000, 1_000_000 or 1e6".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Large numbers are read with underscores and exponents.
    #[test]
    fn large_numbers_accept_exponents() {
        for text in ["1000000", "1_000_000", "1e6", "1.0E+6"] {
            assert_eq!(whole_number(text), Ok(1_000_000), "{text}");
        }
        assert_eq!(whole_number("18446744073709551615"), Ok(u64::MAX));
        for text in ["", "1.5", "-1", "1e-3", "1e300", "inf", "million"] {
            assert!(whole_number(text).is_err(), "{text}");
        }
    }
}
