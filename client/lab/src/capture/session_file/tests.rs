use std::fs::write;

use super::*;

const SOUND: &str = include_str!("tests/session.toml");

/// A folder with a session, empty photographs of these names, and tables; `change` replaces a part of the session by
/// another.
fn read_in(
    names: &[&str],
    tables: &[(&str, &str)],
    session: &str,
    change: (&str, &str),
) -> Result<CaptureSession> {
    let folder = tempfile::tempdir().unwrap();
    for name in names {
        write(folder.path().join(format!("{name}.pgm")), "").unwrap();
    }
    for (name, text) in tables {
        write(folder.path().join(name), text).unwrap();
    }
    assert!(session.contains(change.0), "{}", change.0);
    let path = folder.path().join("session.toml");
    write(&path, session.replacen(change.0, change.1, 1)).unwrap();
    // The temporary folder in paths is replaced by DIR.
    let named = |text: String| text.replace(&folder.path().display().to_string(), "DIR");
    CaptureSession::read(&path).map_err(|e| anyhow::anyhow!(named(format!("{e:#}"))))
}

fn read(change: (&str, &str)) -> Result<CaptureSession> {
    let names = ["dark_1", "dark_2", "chart", "board", "white_2", "white_1", "white_10"];
    read_in(&names, &[], SOUND, change)
}

fn refused(from: &str, to: &str) -> String {
    read((from, to)).unwrap_err().to_string()
}

/// Fields that a session file omits have the paper's values, in the scene of a laboratory.
#[test]
fn absent_session_fields_have_defaults() {
    let session = read(("", "")).unwrap();
    assert_eq!(session.target, Target { square_mm: 20.0, square_std_error_mm: 0.01, dark_side: None });
    assert_eq!(session.parts[0].samples[0].thickness_std_error_mm, 0.005);
    assert_eq!(session.pattern, Some([Colour::Red, Colour::Green, Colour::Green, Colour::Blue]));
    let names = session.shots().map(|p| p.file_stem().unwrap().to_str().unwrap().to_owned());
    let order = ["dark_1", "dark_2", "chart", "board", "white_1", "white_10", "white_2"];
    assert_eq!(names.collect::<Vec<_>>(), order, "in the order of their use, each field's sorted");
    assert_eq!(session.scene, optics_model::Scene::lab());
}

/// The message names file, line and field, and the values that are allowed.
#[test]
fn invalid_values_are_refused_with_range() {
    let message = refused("thickness_mm = 0.512", "thickness_mm = -1");
    let place = "session file DIR/session.toml, line 16: sample[0].thickness_mm = -1";
    assert_eq!(message, format!("{place} is not valid: allowed are 0.01 to 100"));
    let changes = include_str!("tests/refused.txt");
    for (from, to, expected) in table(changes) {
        let message = refused(from, &to);
        assert!(message.starts_with("session file DIR/session.toml"), "{message}");
        assert!(message.contains(expected), "{to}: {message}");
    }
}

/// Changes of a session, one a line: a part of it, its replacement with its lines, and what the message contains.
fn table(changes: &str) -> impl Iterator<Item = (&str, String, &str)> {
    changes.trim().lines().map(|line| {
        let (from, rest) = line.split_once(" >> ").unwrap();
        let (to, expected) = rest.split_once(">> ").unwrap();
        (from, to.trim_end().replace(" | ", "\n"), expected)
    })
}

/// `mono` is the pattern of a monochrome camera; other names are refused.
#[test]
fn mono_is_a_valid_pattern() {
    assert_eq!(pattern("mono").unwrap(), pattern("RGGB").unwrap());
    let refused = pattern("grey").unwrap_err().to_string();
    assert!(refused.ends_with("and \"mono\""), "{refused}");
}

/// Numbers that are hardly intended are named with the usual range.
#[test]
fn implausible_numbers_are_named() {
    let doubts = |from: &str, to: &str| read((from, to)).unwrap().doubts.join("; ");
    assert_eq!(doubts("", ""), "");
    let changes = include_str!("tests/doubted.txt");
    for (from, to, message) in table(changes) {
        assert!(doubts(from, &to).starts_with(message), "{}", doubts(from, &to));
    }
    for (name, mm, message) in [
        ("White", 1.0, "sample[1].material = \"White\" differs from \"white\" only in case"),
        ("white", 0.5121, "sample[1].thickness_mm = 0.5121 is nearly that of another slab, 0.512"),
        ("white", 1.0, ""),
    ] {
        let other =
            format!("[[sample]]\nmaterial = \"{name}\"\nthickness_mm = {mm}\nshots = [\"white_2.pgm\"]\n");
        let found = doubts("shots = [\"white_*.pgm\"]\n", &format!("shots = [\"white_1*.pgm\"]\n{other}"));
        assert!(found.starts_with(message) && found.is_empty() == message.is_empty(), "{found}");
    }
}

/// Readings give their mean, and its error by their scatter and the instrument's; those that differ by more than 1 % are
/// doubted.
#[test]
fn readings_of_a_thickness_are_averaged() {
    let with = |readings: &str| read(("thickness_mm = 0.512", &format!("thickness_mm = {readings}")));
    let session = with("[0.510, 0.512, 0.514]").unwrap();
    let sample = &session.parts[0].samples[0];
    assert_eq!((sample.thickness_mm, session.doubts.len()), (0.512, 0));
    let stated = read(("", "")).unwrap().parts[0].samples[0].thickness_std_error_mm;
    let expected = libm::hypot(stated, 0.002 / 3.0_f64.sqrt());
    assert!((sample.thickness_std_error_mm - expected).abs() < 1e-9, "{}", sample.thickness_std_error_mm);
    let doubts = with("[0.505, 0.512, 0.519]").unwrap().doubts;
    assert!(doubts[0].starts_with("sample[0].thickness_mm: the readings differ by 2.7 %"), "{doubts:?}");
    for (readings, message) in [
        ("[]", "at least one reading"),
        ("[0.5, -1]", "thickness_mm = -1"),
        ("\"thin\"", "a number is needed, or a list"),
    ] {
        let error = format!("{:#}", with(readings).unwrap_err());
        assert!(error.contains(message), "{error}");
    }
}

/// Byte-order marks, which editors of Windows write, are read.
#[test]
fn byte_order_marks_are_read() {
    assert_eq!(read(("# A", "\u{feff}# A")).unwrap().parts[0].dark.len(), 2);
}

/// A session file with two bands, in a folder with their photographs; `change` replaces a part of it by another.
fn read_bands(change: (&str, &str)) -> Result<CaptureSession> {
    read_bands_with(change, "")
}

/// The same, with the table of a filter.
fn read_bands_with(change: (&str, &str), filter: &str) -> Result<CaptureSession> {
    let names = ["dark", "blue_chart", "blue_board", "blue_white", "630_chart", "630_board", "630_white"];
    let rho = "wavelength_nm,a,b,c\n400,0.8,0.4,0.1\n700,0.95,0.4,0.1\n";
    let session = include_str!("tests/bands.toml");
    read_in(&names, &[("filter.csv", filter), ("rho.csv", rho)], session, change)
}

/// Each band has its own photographs and reflectances; dark shots may be shared.
#[test]
fn bands_have_their_own_photographs() {
    let session = read_bands(("", "")).unwrap();
    let names = session.shots().map(|p| p.file_stem().unwrap().to_str().unwrap().to_owned());
    let expected =
        ["dark", "blue_chart", "blue_board", "blue_white", "dark", "630_chart", "630_board", "630_white"];
    assert_eq!(names.collect::<Vec<_>>(), expected);
    let channels = session.parts.iter().map(|part| part.band.as_ref().unwrap().channel());
    assert_eq!(channels.collect::<Vec<_>>(), ["450", "630"]);
    let white = |nm: f64| 0.8 + 0.15 * (nm - 400.0) / 300.0;
    for (part, nm) in session.parts.iter().zip([450.0, 630.0]) {
        let expected = Neutral::new(vec![vec![white(nm)], vec![0.4], vec![0.1]], 0.01, None).unwrap();
        let rho = |neutral: &Neutral| format!("{neutral:.9?}");
        assert_eq!(rho(&part.neutral), rho(&expected));
    }
}

/// A filter whose table shows light far from its passband is doubted.
#[test]
fn leaking_filters_are_doubted() {
    let doubts = |leak: f64| {
        let filter =
            format!("wavelength_nm,t\n440,0\n445,1\n455,1\n460,0\n620,0\n625,{leak}\n635,{leak}\n640,0\n");
        let session = read_bands_with(("fwhm_nm = 10", "transmission = \"filter.csv\""), &filter);
        session.unwrap().doubts
    };
    assert_eq!(doubts(0.0), [""; 0]);
    let found = doubts(0.01);
    assert!(
        found.len() == 1 && found[0].starts_with("the filter of band \"blue\" passes 1.0 % of the light"),
        "{found:?}"
    );
}

/// The message names the field and the remedy.
#[test]
fn wrong_bands_are_refused() {
    let changes = include_str!("tests/refused-bands.txt");
    for (from, to, message) in table(changes) {
        let refused = format!("{:#}", read_bands((from, &to)).unwrap_err());
        assert!(refused.contains(message), "{refused}");
    }
}

/// A narrow slab is doubted, one of 40 mm is not.
#[test]
fn narrow_slabs_are_doubted() {
    let doubts = |slab_mm: &str| {
        let given = format!("slab_mm = {slab_mm}\nthickness_mm = 0.512");
        read(("thickness_mm = 0.512", &given)).map(|session| session.doubts)
    };
    let narrow = doubts("[20, 60]").unwrap();
    assert!(narrow.iter().any(|d| d.starts_with("sample[0].slab_mm = [20, 60]: light leaves")), "{narrow:?}");
    assert_eq!(doubts("[40, 60]").unwrap(), [""; 0]);
    let message = doubts("[0, 60]").unwrap_err().to_string();
    assert!(message.contains("sample[0].slab_mm = 0 is not valid: allowed are 1 to 1000"), "{message}");
}

/// A certificate becomes what the ring of 40 to 50° shows; without a geometry a white is less certain, with a warning.
#[test]
fn certificates_are_converted_to_the_ring() {
    let given = |geometry: &str| read(("rho = [0.9,", &format!("{geometry}rho = [0.989,")));
    let found = |geometry: &str| {
        let session = given(geometry).unwrap();
        let doubts = session.doubts.iter().filter(|d| d.contains("geometry")).count();
        let neutral = format!("{:.6?}", session.parts[0].neutral);
        let error = neutral.split("std_error: ").nth(1).unwrap();
        (session.parts[0].neutral.brightest(), error[..8].parse::<f64>().unwrap(), doubts)
    };
    for (geometry, factor, error, warnings) in [
        ("geometry = \"own\"\n", 1.0, 0.0, 0),
        ("", 1.0, 0.012, 1),
        // A ring of ± 1° by its prior.
        ("geometry = \"45:0\"\n", 1.0, 0.0035, 0),
        ("geometry = \"8:h\"\n", 1.0233, libm::hypot(0.003, 0.0035), 0),
    ] {
        let (white, std_error, doubts) = found(geometry);
        assert!((white - 0.989 * factor).abs() < 1e-9, "{geometry}: {white}");
        assert!((std_error - libm::hypot(0.01, error)).abs() < 1e-5, "{geometry}: {std_error}");
        assert_eq!(doubts, warnings, "{geometry}");
    }
    let message = given("geometry = \"0:45\"\n").unwrap_err().to_string();
    assert!(message.contains("0:45") && message.contains("`8:h`"), "{message}");
}

/// Further shots are read in the order of their use; those of a slab without blue belong to colours alone.
#[test]
fn further_shots_are_read() {
    let names = ["dark_1", "chart", "board", "long", "short", "edge", "trap", "gel", "white_1", "cut"];
    let whole = SOUND.replace("[target]", "exposures = [\"long.pgm\", \"short.pgm\"]\n[target]").replace(
        "[target]",
        "[target]\nedge = [\"edge.pgm\"]\nhaze = [\"trap.pgm\"]\nin_gel = [\"gel.pgm\"]",
    ) + "blue_cut = [\"cut.pgm\"]\n";
    let session = read_in(&names, &[], &whole, ("", "")).unwrap();
    let found = session.shots().map(|p| p.file_stem().unwrap().to_str().unwrap().to_owned());
    let order = ["dark_1", "chart", "long", "short", "board", "edge", "trap", "gel", "white_1", "cut"];
    assert_eq!(found.collect::<Vec<_>>(), order);
    assert_eq!(session.parts[0].samples[0].blue_cut.len(), 1);
    let bands = include_str!("tests/bands.toml").replace("rho = \"rho.csv\"", "rho = [0.9, 0.5, 0.1]");
    let names =
        ["dark", "blue_chart", "blue_board", "blue_white", "630_chart", "630_board", "630_white", "cut"];
    let message =
        read_in(&names, &[], &(bands + "blue_cut = [\"cut.pgm\"]\n"), ("", "")).unwrap_err().to_string();
    assert!(message.contains("sample[0].blue_cut") && message.contains("compare a filter"), "{message}");
}

/// A camera's sensitivities, under the lamps, give means and widths of its colours; without three in order they are refused.
#[test]
fn sensitivities_give_the_widths_of_colours() {
    let names = ["dark_1", "chart", "board", "white_1"];
    let table = |peaks: [f64; 3]| {
        let row = |nm: i32| {
            let [r, g, b] = peaks.map(|at| libm::exp(-0.5 * ((f64::from(nm) - at) / 20.0).powi(2)));
            format!("{nm},{r:.6},{g:.6},{b:.6}\n")
        };
        "wavelength_nm,R,G,B\n".to_owned() + &(38..=70).map(|i| row(10 * i)).collect::<String>()
    };
    let read = |peaks: [f64; 3], session: &str| {
        // Lamps that are stronger by a factor of e for each 100 nm.
        let lamp = (35..=75)
            .map(|i| format!("{},{:.6}\n", 10 * i, libm::exp(0.1 * f64::from(i))))
            .collect::<String>();
        let tables = [("ssf.csv", table(peaks)), ("lamp.csv", format!("wavelength_nm,power\n{lamp}"))];
        let tables: Vec<(&str, &str)> = tables.iter().map(|(name, text)| (*name, text.as_str())).collect();
        read_in(&names, &tables, session, ("[camera]", "[camera]\nsensitivity = \"ssf.csv\""))
    };
    let peaks = [600.0, 540.0, 460.0];
    let colours = read(peaks, SOUND).unwrap().colours.unwrap();
    for ((nm, std_dev), expected) in colours.into_iter().zip(peaks) {
        assert!((nm - expected).abs() < 0.1 && (std_dev - 20.0).abs() < 0.1, "{nm} {std_dev}");
    }
    // A Gaussian moves by its variance times the slope of the logarithm.
    let lit = read(peaks, &SOUND.replace("[neutral]", "[light]\nspectrum = \"lamp.csv\"\n[neutral]"));
    assert!((lit.unwrap().colours.unwrap()[1].0 - 544.0).abs() < 0.1);
    let message = read([460.0, 540.0, 600.0], SOUND).unwrap_err().to_string();
    assert!(message.contains("camera.sensitivity") && message.contains("red at the longest"), "{message}");
}
