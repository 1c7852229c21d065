//! Tests of pixels that are rounded, masked or without errors.

use super::*;

#[test]
fn rounded_places_are_even_with_a_note() {
    let row = |(x, v): (f64, f64)| format!("w,R,0.5,{x:.2},{v:.5},0.002\n");
    let text: String = (0..360)
        .map(|i| (f64::from(i) - 179.5) / 36.0)
        .map(|x| row((x, 0.45 + 0.3 * libm::tanh(x))))
        .collect();
    let file = parse(&format!("{HEAD}{text}"));
    assert_eq!(codes(&file), ["ROUNDED_X"]);
    let profile = &file.materials[0].profiles()[0];
    assert!(
        (profile.x_mm()[0] + 179.5 / 36.0).abs() < 0.005 && (profile.pitch_mm() - 1.0 / 36.0).abs() < 1e-4
    );
}

/// The rows of a profile, of which those of these numbers have this cell as value and error, or are absent.
fn without(numbers: &[usize], cell: Option<&str>) -> String {
    let row = |(i, line): (usize, &str)| {
        let cells: Vec<&str> = line.split(',').collect();
        let keep = !numbers.contains(&i);
        if keep {
            Some(format!("{line}\n"))
        } else {
            cell.map(|c| format!("{},{c},{c}\n", cells[..4].join(",")))
        }
    };
    rows("w", "R", 0.5).lines().enumerate().filter_map(row).collect()
}

#[test]
fn pixels_without_a_value_have_no_weight() {
    let whole = parse(&(HEAD.to_owned() + &rows("w", "R", 0.5)));
    let whole = &whole.materials[0].profiles()[0];
    for cell in [Some("NaN"), Some(""), Some("--"), None] {
        let file = parse(&format!("{HEAD}{}", without(&[20, 21, 40], cell)));
        assert_eq!(codes(&file), ["MISSING_PIXELS"]);
        let text = &file.notes[0].text;
        assert!(text.starts_with("3 pixels without a value are interpolated"), "{text}");
        let profile = &file.materials[0].profiles()[0];
        assert!(profile.x_mm().iter().zip(whole.x_mm()).all(|(a, b)| (a - b).abs() < 1e-4), "{cell:?}");
        for (i, error) in profile.std_errors().unwrap().iter().enumerate() {
            assert_eq!(*error, if [20, 21, 40].contains(&i) { 1.0 } else { 0.002 });
        }
        assert!(profile.values().iter().zip(whole.values()).all(|(a, b)| (a - b).abs() < 0.005));
    }
    let ends = parse(&format!("{HEAD}{}", without(&[0, 59], Some(""))));
    assert_eq!(ends.materials[0].profiles()[0].x_mm().len(), 58);
}

/// A profile with too many missing pixels is refused, and one of which every second is missing in a part.
#[test]
fn mostly_missing_profile_is_refused() {
    let many: Vec<usize> = (10..17).collect();
    is_refused(&without(&many, Some("")), "7 of 60 rows have no value; a tenth may be without");
    is_refused(&without(&[1, 3, 5, 7, 9, 11, 13], None), "pixels must be equally spaced");
}

/// The standard error may be empty for a profile, but not for a row.
#[test]
fn std_error_is_empty_for_whole_profiles() {
    let without = rows("vv", "R", 0.5).replace(",0.002\n", ",\n");
    let file = parse(&format!("{HEAD}{}{without}", rows("w", "R", 0.5)));
    assert_eq!(codes(&file), ["STD_ERRORS"]);
    assert!(file.notes[0].text.starts_with("std_error is empty in 1 profile, the first of them in line 62"));
    let errors = [0, 1].map(|m: usize| file.materials[m].profiles()[0].std_errors().is_some());
    assert_eq!(errors, [true, false]);
    let one = rows("w", "R", 0.5).replacen(",0.002\n", ",\n", 1);
    let message = error(&format!("{HEAD}{one}"));
    assert!(
        message.ends_with(
            "std_error is empty in line 2 but given in line 3: give it in all rows of a profile or in none"
        ),
        "{message}"
    );
}
