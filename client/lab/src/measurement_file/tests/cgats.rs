//! Tables of spectrophotometers.

use optics_model::Measurement;

use super::{error, parse};

/// Two patches in three bands, in per cent.
const TABLE: &str = "CGATS.17\n\nORIGINATOR \"an instrument\"\nNUMBER_OF_FIELDS 6\nTHICKNESS_MM 2\nBEGIN_DATA_FORMAT\n\
SAMPLE_ID SAMPLE_NAME LAB_L SPECTRAL_NM460 SPECTRAL_NM470\nSPECTRAL_NM480\nEND_DATA_FORMAT\nNUMBER_OF_SETS 2\n\
BEGIN_DATA\n1 \"light grey\" 71.2 31.5 32.25 33\n2\tcyan\t40\t12.5\t13.5\t0.5\nEND_DATA\n";

#[test]
fn rows_of_a_table_are_patches() {
    let file = parse(TABLE);
    let names: Vec<&str> = file.materials.iter().map(Measurement::material).collect();
    assert_eq!(names, ["light grey", "cyan"]);
    let profiles = file.materials[0].profiles();
    let row = |i: usize| (profiles[i].channel(), profiles[i].thickness_mm(), profiles[i].values()[0]);
    assert_eq!([row(0), row(1), row(2)], [("460", 2.0, 0.315), ("470", 2.0, 0.3225), ("480", 2.0, 0.33)]);
    assert_eq!(file.notes.len(), 1, "{:?}", file.notes);
    assert!(file.notes[0].text.contains("3 wavelengths from 460 to 480 nm, of 100 for white"));
}

/// Names in decomposed letters are those in composed ones, as media are called.
#[test]
fn names_of_patches_are_in_composed_letters() {
    let file = parse(&TABLE.replace("cyan", "Gru\u{308}n").replace("light grey", "light\u{a0}grey"));
    let names: Vec<&str> = file.materials.iter().map(Measurement::material).collect();
    assert_eq!(names, ["light grey", "Gr\u{fc}n"]);
}

/// Names of columns as instruments and programs write them, with thickness and errors in the rows.
#[test]
fn names_of_bands_are_recognised() {
    for names in ["SPEC_460 SPEC_470 SPEC_480", "nm460 nm470 nm480", "R_460 R_470 R_480", "460nm 470nm 480nm"]
    {
        let table = format!(
            "CGATS.17\nBEGIN_DATA_FORMAT\nSAMPLE_NAME THICKNESS_MM STD_ERROR {names}\nEND_DATA_FORMAT\nBEGIN_DATA\n\
             a 0.5 0.002 0,25 0.26 0.27\na 1 0.003 0.35 0.36 0.37\nEND_DATA\n"
        );
        let profiles = parse(&table).materials.remove(0);
        let values: Vec<f64> = profiles.profiles().iter().map(|p| p.values()[0]).collect();
        assert_eq!(values, [0.25, 0.26, 0.27, 0.35, 0.36, 0.37], "{names}");
        assert_eq!(profiles.profiles()[5].thickness_mm(), 1.0);
    }
}

#[test]
fn incomplete_tables_are_refused() {
    let without = |part: &str| error(&TABLE.replace(part, ""));
    for (message, expected) in [
        (without("END_DATA\n"), "not complete"),
        (without("2\tcyan\t40\t12.5\t13.5\t0.5\n"), "1 of 2 rows"),
        (without("THICKNESS_MM 2\n"), "THICKNESS_MM"),
        (without("\t13.5"), "line 13 has 5 values, but the CGATS table has 6 columns"),
        (error(&TABLE.replace("13.5", "dark")), "line 13, SPECTRAL_NM470: \"dark\" is not a number"),
        (error(&TABLE.replace("SPECTRAL_NM", "XYZ")), "no reflectances"),
        (error(&format!("{TABLE}{TABLE}")), "a second CGATS table begins"),
        (error(&TABLE.replace("NUMBER_OF_FIELDS 6", "SPECTRAL_NORM 0")), "SPECTRAL_NORM = 0 is not valid"),
    ] {
        assert!(message.contains(expected), "{message}");
    }
}
