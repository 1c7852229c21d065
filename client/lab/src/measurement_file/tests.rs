mod cgats;
mod forms;
mod pixels;
mod spellings;

use super::*;

/// Pixels of a profile whose edge is blurred over the slab's thickness and loses contrast with it.
fn pixels(thickness: f64) -> impl DoubleEndedIterator<Item = (f64, f64)> {
    let value = move |x: f64| 0.45 + 0.35 * (1.25 - 0.5 * thickness) * libm::tanh(0.5 * x / thickness);
    (0..60).map(|i| (f64::from(i) - 29.5) / 6.0).map(move |x| (x, value(x)))
}

fn rows(material: &str, channel: &str, thickness: f64) -> String {
    let row = |(x, v): (f64, f64)| {
        // Channels and materials differ, as in real measurements.
        let v = v * (0.7 + 0.01 * channel.len() as f64 + 0.001 * f64::from(channel.as_bytes()[0] % 32));
        let v = v + 0.01 * material.len() as f64;
        format!("{material},{channel},{thickness},{x:.5},{v:.5},0.002\n")
    };
    pixels(thickness).map(row).collect()
}

const HEAD: &str = "material,channel,thickness_mm,x_mm,value,std_error\n";

fn strict() -> String {
    let body: Vec<String> =
        ["R", "G", "B"].into_iter().flat_map(|c| [0.5, 1.0].map(|t| rows("white", c, t))).collect();
    format!("# a comment\n{HEAD}{}", body.concat())
}

fn parse(text: &str) -> MeasurementFile {
    read(text.as_bytes()).unwrap_or_else(|e| panic!("{e:#}"))
}

fn error(text: &str) -> String {
    format!("{:#}", read(text.as_bytes()).unwrap_err())
}

/// Asserts that the text gives the same measurements as the strict file, and notes of these codes; one contains the
/// message.
#[track_caller]
fn reads_the_same(text: &str, code: &str, message: &str) {
    let (found, strict) = (parse(text), parse(&strict()));
    assert_eq!(found.materials, strict.materials, "{code}");
    assert_eq!(codes(&found), code.split(' ').collect::<Vec<_>>());
    let all: String = found.notes.iter().map(|n| n.text.clone() + "\n").collect();
    assert!(all.contains(message), "{all}");
}

fn codes(file: &MeasurementFile) -> Vec<&'static str> {
    file.notes.iter().map(|n| n.code).collect()
}

/// Asserts that these rows below the strict head are refused with a message that contains this one.
#[track_caller]
fn is_refused(rows: &str, message: &str) {
    let found = error(&format!("{HEAD}{rows}"));
    assert!(found.contains(message), "{found}");
}

/// The strict format is read without a note.
#[test]
fn strict_format_is_read_without_notes() {
    let body = rows("white", "R", 0.5) + &rows("yellow", "R", 0.5) + &rows("white", "R", 1.0);
    let file = parse(&format!("# a comment\n{HEAD}{body}"));
    assert_eq!(file.notes, []);
    assert_eq!(file.materials.iter().map(Measurement::material).collect::<Vec<_>>(), ["white", "yellow"]);
    assert_eq!(file.materials[0].profiles().len(), 2);
    assert_eq!(file.materials[0].profiles()[1].std_errors().unwrap(), [0.002; 60]);
    let shipped = read(include_bytes!("../../../../examples/white.csv")).unwrap();
    assert_eq!(shipped.notes, []);
}

/// Each assumption has a note: separators, decimal commas, headings, colours, blank rows and order.
#[test]
fn spreadsheet_variants_are_read_with_a_note() {
    let strict = strict();
    let semicolons = strict.replace(',', ";");
    let german = semicolons.replace('.', ",");
    let renamed = strict.replacen(HEAD, "Sample,Channel,Thickness (mm),Position,Radiance,sigma\n", 1);
    let colours = strict.replace(",R,", ",red,").replace(",G,", ",Green,").replace(",B,", ",b,");
    let blank = strict.replacen("white,G", ",,,,,\n \nwhite,G", 1) + "\n\n,,,,,\n";
    let all = ["\u{feff}", &german.replace("material", "Resin").replace(";R;", ";Red;")].concat();
    for (text, code, message) in [
        (&semicolons, "SEPARATOR", "separated by semicolons"),
        (&strict.replace(',', "\t"), "SEPARATOR", "separated by tabs"),
        (&strict.replace(',', "|"), "SEPARATOR", "separated by '|'"),
        (&format!("sep=;\r\n{semicolons}"), "SEPARATOR", "semicolons"),
        (&german, "SEPARATOR DECIMAL_COMMA", "\"0,5\" is read as 0.5"),
        (&renamed, "COLUMNS", "\"Thickness (mm)\" is read as thickness_mm"),
        (&colours, "CHANNELS", "\"red\" is read as R, \"Green\" is read as G, \"b\" is read as B"),
        (&blank, "BLANK_ROWS", "without any entry"),
        (&all, "ENCODING SEPARATOR COLUMNS DECIMAL_COMMA CHANNELS", "Resin"),
    ] {
        reads_the_same(text, code, message);
    }
    let (head, body) = strict.split_at(strict.find("white").unwrap());
    let falling: String = body.lines().rev().map(|l| format!("{l}\n")).collect();
    let falling = parse(&format!("{head}{falling}"));
    assert_eq!(falling.notes[0].text, "x falls along 6 profiles, read from the other end");
    let rising = parse(&strict);
    assert!(falling.materials[0].profiles().iter().all(|p| rising.materials[0].profiles().contains(p)));
}

#[test]
fn wavelengths_and_other_names_of_channels_stay() {
    let text = HEAD.to_owned() + &rows("white", "450", 0.5) + &rows("white", "red", 0.5);
    let file = parse(&text);
    assert_eq!(file.materials[0].channels(), ["450", "red"]);
    assert_eq!(file.notes, []);
}

/// Units in the names of columns are converted.
#[test]
fn units_in_column_names_are_converted() {
    let row = |(x, v): (f64, f64)| format!("w,R,500,{:.4},{:.4}\n", 1000.0 * x, 100.0 * v);
    let text: String = pixels(0.5).map(row).collect();
    let file = parse(&format!("material,channel,thickness (um),x_um,value (%)\n{text}"));
    let profile = &file.materials[0].profiles()[0];
    assert_eq!(profile.thickness_mm(), 0.5);
    assert!((profile.x_mm()[0] + 29.5 / 6.0).abs() < 1e-6 && profile.values()[59] < 0.81);
}

/// Bad rows, numbers that can be read in two ways, and mistakes in the measured values are refused with line and column.
#[test]
fn bad_rows_are_refused_with_their_line() {
    let start: String = rows("w", "R", 0.5).split_inclusive('\n').take(2).collect();
    let gap = rows("w", "R", 0.5).replacen("w,R,0.5,-4.41667", "w,R,0.5,-4.40667", 1);
    let shifted = pixels(0.5).map(|(x, v)| format!("w,R,0.5,{:.6},{v},0.002\n", x + 5.0)).collect();
    let slabs =
        rows("w", "R", 0.5).replace(",R,0.5,", ",R,1,") + &rows("w", "R", 1.0).replace(",R,1,", ",R,0.5,");
    let twice = |other: &str| rows("w", "R", 0.5) + &rows("w", other, 0.5);
    let twin = rows("w", "R", 0.5) + &rows("w", "R", 0.5).replace(",R,", ",G,");
    for (rows, message) in [
        (start.clone() + "w,R,0.5,zero,1,0\n", "line 4: x_mm = \"zero\" is not a number"),
        (start.clone() + "w,R,0.5,0.2,inf,0\n", "line 4: value = inf is not a finite number"),
        (String::new(), "no rows"),
        (start, "line 2, material w, channel R, 0.5 mm: x_mm = 2 pixels is not valid"),
        (gap.clone(), "line 5, material w, channel R, 0.5 mm: x_mm["),
        (gap, "pixels must be equally spaced"),
        ("w,R,0.5,\"1,234\",0.5,0\n".to_owned(), "line 2 has \"1,234\" and line 2 has \"0.5\""),
        (
            "w,R,1,\"1,234.5\",0,0\n".to_owned(),
            "line 2: \"1,234.5\" seems to have commas between thousands: write numbers without them",
        ),
        (twice("red"), "line 62, material w, 0.5 mm: channel \"red\" means R, which is there under"),
        (twice("R"), "line 2, material w, channel R, 0.5 mm: x_mm = -4.91667 stands here and in line 62"),
        (
            shifted,
            "its edge seems to be at x = 5.00 mm: x = 0 must be at the edge, so \
             subtract 5.00 mm",
        ),
        (slabs, "line 62, material w, channel R, 0.5 mm: the slab of 1 mm shows more of the edge"),
        (twin, "line 62, material w, channel G, 0.5 mm: the values are those of channel R at 0.5 mm"),
    ] {
        is_refused(&rows, message);
    }
}

/// Heads and numbers that cannot be read, or in two ways, are refused with line and column.
#[test]
fn bad_files_are_refused_with_their_line() {
    let doubtful: String = (0..20).map(|i| format!("w;R;1;{};1,{:03}\n", i - 10, 100 + i)).collect();
    let strict = strict();
    for (text, message) in [
        ("material,channel,x_mm\nw,R,0\n", "missing columns thickness_mm, value; needed are"),
        ("material,hue\n", "column \"hue\" is not known"),
        ("\n \n", "the file is empty"),
        (&rows("w", "R", 0.5), "the first line has numbers"),
        ("# a comment\nmaterial,channel,thickness_mm,x_mm,value\nw,R,1,zero,1\n", "line 3: x_mm = \"zero\""),
        (
            &strict.replacen("white,R,0.5,-4.91667", "white,R,\"0,5\",-4.91667", 1),
            "line 3 has \"0,5\" and line 3 has \"-4.91667\": with points and commas",
        ),
        (
            &format!("material;channel;thickness_mm;x_mm;value\n{doubtful}"),
            "line 2: \"1,100\" can be 1.100 or 1100; write it with a decimal point",
        ),
        (
            "material,channel,thickness_mm,x_mm,value\nw,R,0,5,-4,97,0,31\n",
            "line 2 has 8 entries where the header has 5: if its commas are decimal, separate the columns by semicolons",
        ),
        (
            &strict.replacen("std_error", "radiance", 1),
            "columns \"value\" and \"radiance\" could both be value",
        ),
    ] {
        assert!(error(text).contains(message), "{}", error(text));
    }
}

#[test]
fn row_without_x_is_a_patch() {
    let found = parse(&(strict() + "white,R,2,,0.61,0.004\n"));
    let patch = found.materials[0].profiles().last().unwrap();
    assert!(patch.thickness_mm() == 2.0 && patch.values().iter().all(|v| *v == 0.61));
    // The pixels of the patch together are as certain as the row.
    let information: f64 = patch.std_errors().unwrap().iter().map(|e| e.powi(-2)).sum();
    assert!((libm::pow(information, -0.5) - 0.004).abs() < 1e-12);
    for (rows, message) in [
        ("white,R,2,,0.61,0\n", "a patch needs one above 0"),
        ("white,R,2,,0.61,0.004\nwhite,R,2,,0.62,0.004\n", "a patch has one"),
    ] {
        let found = error(&(strict() + rows));
        assert!(found.contains("line 363") && found.contains(message), "{found}");
    }
}

const SETUP_HEAD: &str = "material,channel,thickness_mm,x_mm,value,std_error,thickness_std_error_mm,origin_mm,\
                          origin_std_error_mm,blur_mm,blur_std_error_mm\n";

/// A profile with the same cells at the end of every row.
fn with_cells(channel: &str, thickness: f64, cells: &str) -> String {
    rows("w", channel, thickness).lines().map(|line| format!("{line},{cells}\n")).collect()
}

/// The columns of the set-up are read, and their cells may be empty.
#[test]
fn set_up_columns_may_be_empty() {
    let thin = with_cells("R", 0.5, "0.004,0.02,0.005,0.025,0.001");
    let file = parse(&format!("{SETUP_HEAD}{thin}{}", with_cells("R", 1.0, ",,,,")));
    assert_eq!(file.notes, []);
    let [thin, thick] = file.materials[0].profiles() else { panic!("two profiles") };
    let setup = thin.setup();
    assert_eq!((setup.thickness_std_error_mm, setup.origin_mm), (Some(0.004), Some(0.02)));
    assert_eq!((setup.origin_std_error_mm, setup.blur_mm), (Some(0.005), Some(0.025)));
    assert_eq!(setup.blur_std_error_mm, Some(0.001));
    assert_eq!(thick.setup(), &optics_model::measurement::ProfileSetup::default());
}

/// The edge is expected at origin_mm, or at zero. At another position it is refused with the correct value.
#[test]
fn edge_away_from_zero_needs_origin_mm() {
    let shifted = |origin: &str| {
        let row = |(x, v): (f64, f64)| format!("w,R,0.5,{:.5},{v:.5},{origin}\n", x + 2.0);
        let body: String = pixels(0.5).map(row).collect();
        format!("material,channel,thickness_mm,x_mm,value,origin_mm\n{body}")
    };
    let found = parse(&shifted("2"));
    assert_eq!((found.notes.len(), found.materials[0].profiles()[0].setup().origin_mm), (0, Some(2.0)));
    for (origin, message) in [
        ("", "x = 0 must be at the edge, so subtract 2.00 mm from every x"),
        ("-1", "does not rise at origin_mm = -1; its edge seems to be at x = 2.00 mm: set origin_mm = 2.00"),
    ] {
        assert!(error(&shifted(origin)).contains(message), "{}", error(&shifted(origin)));
    }
}

/// The message names line and field. Values must be in range, and the same in all rows of a profile.
#[test]
fn inconsistent_set_up_columns_are_refused() {
    let message = |cells: &str| error(&format!("{SETUP_HEAD}{}", with_cells("R", 0.5, cells)));
    for (cells, expected) in [
        (
            ",6,,,",
            "origin_mm = 6 is not valid: the profile's x runs from -4.91667 to 4.91667 mm, and the edge must lie within",
        ),
        (",-11,,,", "origin_mm = -11 is not valid: allowed are -10 to 10"),
        ("-0.01,,,,", "thickness_std_error_mm = -0.01 is not valid: allowed are 0 to 1"),
        (",,,1.5,", "blur_mm = 1.5 is not valid: allowed are 0 to 1"),
        (",,,,-1", "blur_std_error_mm = -1 is not valid: allowed are 0 to 1"),
    ] {
        assert_eq!(message(cells), format!("line 2, material w, channel R, 0.5 mm: {expected}"));
    }
    assert_eq!(message(",wide,,,"), "line 2: origin_mm = \"wide\" is not a number");
    let rows = with_cells("R", 0.5, ",,,0.02,");
    let eighth = rows.lines().nth(7).unwrap();
    for (other, found) in [(",0.03,", "0.03"), (",,", "nothing")] {
        let rows = rows.replacen(eighth, &eighth.replace(",0.02,", other), 1);
        let message = error(&format!("{SETUP_HEAD}{rows}"));
        let wanted =
            format!("line 9: blur_mm = {found}, but line 2 of the same profile has 0.02: it must be");
        assert!(message.starts_with(&wanted), "{message}");
    }
}

/// Suspicions become notes, one of each kind.
#[test]
fn suspicions_are_noted_once_per_kind() {
    let row = |material: &str, thickness: f64, (x, v): (f64, f64)| {
        format!("white,{material},{thickness},{:.6},{v:.5},0.002\n", 0.1 * x)
    };
    let body: String = ["R", "G", "B"]
        .into_iter()
        .zip([0.0, 0.01, 0.02])
        .flat_map(|(c, more)| {
            [0.5, 1.0].map(|t| pixels(t).map(|(x, v)| row(c, t, (x, v + more))).collect::<String>())
        })
        .collect();
    let file = parse(&format!("{}{body}", HEAD.replace("x_mm", "position")));
    assert_eq!(codes(&file), ["COLUMNS", "UNIT_OF_X"]);
    let message = &file.notes[1].text;
    assert!(
        message.starts_with("line 2, material white, channel R, 0.5 mm: x runs from -0.491667 to"),
        "{message}"
    );
    assert!(message.ends_with("if it is cm, multiply by 10 (the same in 5 more profiles)"), "{message}");
}

/// A material called `#2` makes rows that look like comments.
#[test]
fn whole_rows_among_the_comments_are_noted() {
    let other = strict().lines().skip(2).map(|line| format!("#2 {line}\n")).collect::<String>();
    let file = parse(&format!("{}{other}# an end\n", strict()));
    assert_eq!((file.materials.len(), file.notes[0].code), (1, "COMMENTED_ROWS"));
    let wanted =
        "360 lines that begin with # hold whole rows and are left out as comments, the first of them";
    assert!(file.notes[0].text.starts_with(wanted), "{}", file.notes[0].text);
}

/// Files that the program writes are read back without a note.
#[test]
fn own_files_are_read_back_without_notes() {
    use optics_model::{Estimate, Profile, Scene};
    let scene = Scene::paper();
    let profile = |i: usize| {
        let x = |pixel| scene.sensor().centre_mm(pixel);
        let values = (0..360).map(|p| (0.45 + 0.01 * i as f64 + 0.3 * libm::tanh(x(p))) as f32).collect();
        Profile { radiance_factor: Estimate::new(values, vec![0.001; 360]).unwrap(), derivatives: None }
    };
    let profiles: Vec<Profile> = (0..3).map(profile).collect();
    for name in ["white", "#1, \"Vero\" white"] {
        let mut bytes = Vec::new();
        let mut writer = MeasurementWriter::new(&mut bytes, name).unwrap();
        writer.add(&scene, 0.5, &profiles).unwrap();
        writer.finish().unwrap();
        let file = read(&bytes).unwrap();
        assert_eq!((file.materials[0].material(), file.notes.len()), (name, 0));
        assert_eq!(file.materials[0].channels(), ["R", "G", "B"]);
        let setup = file.materials[0].profiles()[1].setup();
        assert_eq!((setup.thickness_std_error_mm, setup.origin_mm), (Some(0.0), Some(0.0)));
        assert_eq!((setup.blur_mm, setup.blur_std_error_mm), (Some(0.0), Some(0.0)));
        let value = profiles[2].radiance_factor.values()[7];
        assert_eq!(file.materials[0].profiles()[2].values()[7] as f32, value);
    }
    for bad in ["", " white", "a\nb"] {
        assert!(MeasurementWriter::new(Vec::new(), bad).is_err(), "{bad:?}");
    }
}
