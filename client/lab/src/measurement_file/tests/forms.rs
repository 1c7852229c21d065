//! Tests of headers, preambles and rows of units.

use super::*;

/// Headers in comments are read.
#[test]
fn commented_headers_are_read() {
    let strict = strict();
    let (comment, rest) = strict.split_once("material").unwrap();
    let commented = format!("{comment}# material{rest}");
    reads_the_same(&commented, "COMMENTED_HEADER", "line 2");
    reads_the_same(&commented.replace(',', " "), "COMMENTED_HEADER SEPARATOR", "separated by blanks");
}

/// Preambles and rows of units are refused with their lines.
#[test]
fn preambles_and_unit_rows_are_refused() {
    let preamble = format!("Spectrometer run 7\nOperator;Ä. B.\n\n{HEAD}{}", rows("w", "R", 0.5));
    let wanted =
        "line 1 does not name the columns; line 4 seems to: delete the lines before it, or begin them with #";
    assert_eq!(error(&preamble), wanted);
    for units in [",,mm,mm,,", "-,-,[mm],[mm],-,-", ",,mm,mm,1,%"] {
        let message = error(&format!("{HEAD}{units}\n{}", rows("w", "R", 0.5)));
        assert!(message.starts_with("line 2 seems to hold units: leave it out"), "{units}: {message}");
    }
}
