//! Tests of pixels that are rounded, masked or without errors.

use super::*;

fn codes(file: &MeasurementFile) -> Vec<&'static str> {
    file.notes.iter().map(|n| n.code).collect()
}

#[test]
fn rounded_places_are_even_with_a_note() {
    let row = |(x, v): (f64, f64)| format!("w,R,0.5,{x:.2},{v:.5},0.002\n");
    let text: String =
        (0..360).map(|i| (f64::from(i) - 179.5) / 36.0).map(|x| row((x, 0.45 + 0.3 * x.tanh()))).collect();
    let file = parse(&format!("{HEAD}{text}"));
    assert_eq!(codes(&file), ["ROUNDED_X"]);
    let profile = &file.materials[0].profiles()[0];
    assert!(
        (profile.x_mm()[0] + 179.5 / 36.0).abs() < 0.005 && (profile.pitch_mm() - 1.0 / 36.0).abs() < 1e-4
    );
}

#[test]
fn pixels_without_a_value_have_no_weight() {
    let whole = parse(&(HEAD.to_owned() + &rows("w", "R", 0.5)));
    let lines: Vec<String> = rows("w", "R", 0.5).lines().map(ToOwned::to_owned).collect();
    let masked = |cell: &str| {
        let row = |(i, line): (usize, &String)| {
            let cells: Vec<&str> = line.split(',').collect();
            let keep = ![20, 21, 40].contains(&i);
            if keep { line.clone() } else { format!("{},{cell},{cell}", cells[..4].join(",")) }
        };
        lines.iter().enumerate().map(row).collect::<Vec<_>>().join("\n")
    };
    let absent = lines.iter().enumerate().filter(|(i, _)| ![20, 21, 40].contains(i)).map(|(_, l)| l.clone());
    let absent = absent.collect::<Vec<_>>().join("\n");
    for body in [masked("NaN"), masked(""), masked("--"), absent] {
        let file = parse(&format!("{HEAD}{body}\n"));
        assert_eq!(codes(&file), ["MISSING_PIXELS"]);
        assert!(
            file.notes[0].text.starts_with("3 pixels without a value are interpolated"),
            "{:?}",
            file.notes
        );
        let (profile, whole) = (&file.materials[0].profiles()[0], &whole.materials[0].profiles()[0]);
        let errors = profile.std_errors().unwrap();
        assert_eq!((profile.values().len(), errors[20], errors[22]), (60, 1.0, 0.002));
        assert!(profile.values().iter().zip(whole.values()).all(|(a, b)| (a - b).abs() < 0.005));
    }
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
