//! Tables of spectrophotometers.

use optics_model::{MeasuredProfile, Measurement};

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
    for names in [
        "SPEC_460 SPEC_470 SPEC_480",
        "SPECTRAL_NM_460 SPECTRAL_NM_470 SPECTRAL_NM_480",
        "nm460 nm470 nm480",
        "R_460 R_470 R_480",
        "460nm 470nm 480nm",
    ] {
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
        (without("\t13.5"), "the set of line 13 has 5 values, but the CGATS table has 6 columns"),
        (error(&TABLE.replace("13.5", "dark")), "line 13, SPECTRAL_NM470: \"dark\" is not a number"),
        (error(&TABLE.replace("SPECTRAL_NM", "XYZ")), "no reflectances"),
        (error(&format!("{TABLE}{TABLE}")), "a second CGATS table begins"),
        (error(&TABLE.replace("NUMBER_OF_FIELDS 6", "SPECTRAL_NORM 0")), "SPECTRAL_NORM = 0 is not valid"),
    ] {
        assert!(message.contains(expected), "{message}");
    }
}

/// The notes and the values of a table whose rows are these, with a keyword.
fn read(keyword: &str, rows: &str) -> (String, Vec<f64>) {
    let file = parse(&with_rows(keyword, rows));
    let profiles = file.materials.iter().flat_map(Measurement::profiles);
    (file.notes[0].text.clone(), profiles.map(|p| p.values()[0]).collect())
}

fn with_rows(keyword: &str, rows: &str) -> String {
    format!(
        "CGATS.17\nTHICKNESS_MM 2\n{keyword}\nBEGIN_DATA_FORMAT\nSAMPLE_NAME nm440 nm540 nm640\nEND_DATA_FORMAT\n\
         BEGIN_DATA\n{rows}\nEND_DATA\n"
    )
}

/// The white is 1 or 100 by all values together, or by SPECTRAL_NORM; where both are possible it is asked for.
#[test]
fn white_follows_from_all_values() {
    let fluorescent = read("", "paper 1.59 0.84 0.85");
    assert!(
        fluorescent.0.contains("of 1 for white") && fluorescent.1 == [1.59, 0.84, 0.85],
        "{fluorescent:?}"
    );
    let dark = "black 1.2 1.2 1.1";
    assert!(error(&with_rows("", dark)).contains("Add the line SPECTRAL_NORM 100"));
    assert_eq!(read("SPECTRAL_NORM 100", dark).1[..2], [0.012, 0.012]);
    // With a white the dark patch is known to be in per cent.
    assert_eq!(read("", &format!("{dark}\nwhite 88 90 91")).1[..2], [0.012, 0.012]);
}

/// A patch that is measured several times has the mean, whose error contains their scatter.
#[test]
fn repeated_patches_have_their_mean() {
    let rows = "a 0.5 0.6 0.7\na 0.502 0.6 0.7\nb 0.1 0.1 0.1\na 0.504 0.6 0.7";
    let (note, values) = read("", rows);
    assert!(note.contains("2 patches (4 readings, whose means are taken)"), "{note}");
    assert!((values[0] - 0.502).abs() < 1e-12 && values.len() == 6, "{values:?}");
    let file = parse(&with_rows("", rows));
    // A patch is a profile of equal pixels, whose mean has its error.
    let error = |p: &MeasuredProfile| p.std_errors().unwrap()[0] / (p.values().len() as f64).sqrt();
    let errors: Vec<f64> = file.materials[0].profiles().iter().map(error).collect();
    let n = 3.0_f64.sqrt();
    assert!((errors[0] * n - 0.002).abs() < 1e-9 && (errors[1] * n - 0.001).abs() < 1e-9, "{errors:?}");
}

/// Sets may have several lines; names between tabs may have blanks; spreadsheets put lines into quotes.
#[test]
fn lines_are_read_as_programs_write_them() {
    for rows in [
        "\"light grey\" 0.5\n0.6\n0.7",
        "light grey\t0.5\t0.6\t0.7",
        "\"light grey\"\t0.5\t0.6\t0.7\t",
        "\"\"\"light grey\"\" 0.5 0.6 0.7\"",
    ] {
        let file = parse(&with_rows("", rows));
        assert_eq!(file.materials[0].material(), "light grey", "{rows}");
        assert_eq!(file.materials[0].profiles()[2].values()[0], 0.7, "{rows}");
    }
    let quoted = with_rows("", "a 0.5 0.6 0.7").replace("BEGIN_DATA_FORMAT", "\"BEGIN_DATA_FORMAT\"");
    assert_eq!(parse(&quoted).materials.len(), 1);
}

/// Transmittances, and spectra without the keywords, are refused with what is needed.
#[test]
fn other_tables_of_spectra_are_refused() {
    let transmittances = with_rows("QUANTITY \"TRANSMITTANCE\"", "a 0.5 0.6 0.7");
    assert!(error(&transmittances).contains("QUANTITY is \"TRANSMITTANCE\": reflectances are needed"));
    for separator in ["\t", ",", ";"] {
        let names = ["SampleID", "SampleName", "nm380", "nm390", "nm400", "nm410", "nm420"].join(separator);
        let message = error(&format!("Lab reference\tD50\n\n{names}\n"));
        assert!(message.contains("export it as CGATS"), "{message}");
    }
    let counts = error("512,600,700,800,900\n513,601,702,803,904\n");
    assert!(counts.contains("the first line has numbers"), "{counts}");
}
