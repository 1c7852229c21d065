//! Measurement files: those that `simulate` and `export` write, and the messages about those of users.

use farm_tests::cli::{GRID, HEAD, fails, fails_line, farm, folder, json, rows, run_line, write};
use farm_tests::process::run;
use serde_json::Value;

fn read(dir: &std::path::Path, name: &str) -> String {
    std::fs::read_to_string(dir.join(name)).expect("the file was written")
}

/// The files that `simulate` and `export` write are measured without a note.
#[test]
fn own_files_are_measured_without_a_note() {
    let farm = farm();
    let dir = farm.path();
    let medium = "--sigma-t 6 --albedo 0.999 --g 0.4";
    let ran = run_line(
        dir,
        &format!(
            "simulate {medium} --thickness 0.5,1 --scene paper --walks 5000 --noise 0 --measurement white -o \
             s.csv"
        ),
    );
    assert_eq!((ran.code, ran.stdout.as_str(), ran.stderr.as_str()), (0, "", ""));
    assert!(!dir.join("s.csv.partial").exists());
    let ran = run_line(dir, "export grid --sigma-t 6 --albedo 0.999 --measurement white -o e.csv");
    assert_eq!((ran.code, ran.stderr.as_str()), (0, ""));
    // The dictionary's walks are those of the simulation: the same bytes, except for the order of records.
    let lines = |name: &str| {
        let mut lines: Vec<String> = read(dir, name).lines().map(ToOwned::to_owned).collect();
        lines.sort();
        lines
    };
    assert_eq!(lines("s.csv"), lines("e.csv"));
    assert_eq!(lines("s.csv").len(), 1 + 2 * 3 * 360);
    for file in ["s.csv", "e.csv"] {
        let ran = run_line(dir, &format!("measure {file} --dictionary grid --mu 1 --json"));
        assert_eq!(ran.stderr, "");
        let measured = json(&ran, "measure");
        assert_eq!(measured["notes"], Value::Array(vec![]));
        assert_eq!(measured["materials"][0]["material"], "white");
        let best = &measured["materials"][0]["channels"][0]["candidates"][0];
        assert_eq!(best["sigma_t_per_mm"], 6.0);
        let terms = best["thicknesses"].as_array().unwrap();
        assert!(terms.iter().all(|t| t["value_rms"].as_f64().unwrap() < 1e-6), "{best}");
    }
    let many = ["--measurement writes one medium", "pick one with --sigma-t, --albedo, --g"];
    fails_line(dir, "export grid --measurement white", &many);
}

#[test]
fn simulate_takes_lists_and_names_each_medium() {
    let dir = folder();
    let dir = dir.path();
    let rest = "--walks 5000 --pixels 12";
    let ran = run_line(
        dir,
        &format!("simulate --sigma-t 4,6 --albedo 0.9,0.99 --g 0,0.4 --thickness 0.5,1 {rest} -o all.csv"),
    );
    assert_eq!((ran.code, ran.stdout.as_str(), ran.stderr.as_str()), (0, "", ""));
    let all = read(dir, "all.csv");
    assert!(
        all.starts_with("sigma_t_per_mm,albedo,g,thickness_mm,channel,x_mm,value,std_error\n4,0.9,0,0.5,R,")
    );
    assert_eq!(all.lines().count(), 1 + 16 * 3 * 12);
    let one =
        run_line(dir, &format!("simulate --sigma-t 6 --albedo 0.99 --g 0.4 --thickness 1 {rest}")).stdout;
    let of_one: Vec<&str> = all.lines().filter_map(|l| l.strip_prefix("6,0.99,0.4,1,")).collect();
    assert_eq!(of_one, one.lines().skip(1).collect::<Vec<_>>());
    let ran =
        run_line(dir, &format!("simulate --sigma-t 4,6 --albedo 0.9 --g 0 --thickness 0.5 {rest} --json"));
    let objects: Vec<Value> = ran.stdout.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(objects.len(), 2);
    assert_eq!(
        (&objects[1]["kind"], &objects[1]["data"]["sigma_t_per_mm"]),
        (&"simulate".into(), &6.0.into())
    );
    for (change, message) in [
        (
            "--sigma-t 4,4 --albedo 0.9 --thickness 1",
            "sigma_t = 4 is not valid: each value may be given once",
        ),
        ("--sigma-t 4 --albedo 0.9,1.5 --thickness 1", "albedo = 1.5 is not valid"),
        (
            "--sigma-t 4,6 --albedo 0.9 --thickness 1 --plot-changes p.svg",
            "--plot-changes shows the changes about one medium",
        ),
        ("--sigma-t 4,6 --albedo 0.9 --thickness 1 --measurement m", "give one --sigma-t, --albedo and --g"),
    ] {
        fails_line(dir, &format!("simulate --g 0 {rest} -o bad.csv {change}"), &[message]);
        assert!(!dir.join("bad.csv").exists() && !dir.join("p.svg").exists());
    }
    let lost = format!("simulate --sigma-t 4 --albedo 0.9 --g 0 --thickness 1 {rest} -o none/m.csv");
    fails_line(dir, &lost, &["output none/m.csv", "No such file"]);
}

/// A measurement as a spreadsheet writes it.
fn spreadsheet(channel: &str) -> String {
    let text = HEAD.to_owned() + &rows(channel, 0.5) + &rows(channel, 1.0);
    let text = text.replace(',', ";").replace('.', ",").replace("thickness_mm", "Thickness (mm)");
    format!("\u{feff}{text}\n;;;;\n").replace('\n', "\r\n")
}

/// Notes appear once of each kind, on standard error or in JSON.
#[test]
fn notes_appear_once_per_kind() {
    let farm = farm();
    let dir = farm.path();
    write(dir, "m.csv", &spreadsheet("red"));
    write(dir, "strict.csv", &(HEAD.to_owned() + &rows("R", 0.5) + &rows("R", 1.0)));
    for verb in ["fit", "scale", "measure", "map"] {
        let ran = run_line(dir, &format!("{verb} m.csv --dictionary grid"));
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let notes: Vec<&str> = ran.stderr.lines().collect();
        assert_eq!(notes.len(), 6, "{verb}: {}", ran.stderr);
        assert!(notes.iter().all(|l| l.starts_with("farmctl: note: m.csv: ")), "{verb}: {}", ran.stderr);
        assert_eq!(ran.stdout, run_line(dir, &format!("{verb} strict.csv --dictionary grid")).stdout);
        let ran = run_line(dir, &format!("{verb} m.csv --dictionary grid --json"));
        assert_eq!(ran.stderr, "");
        let data = json(&ran, verb);
        let codes: Vec<_> = data["notes"].as_array().unwrap().iter().map(|n| n["code"].clone()).collect();
        let expected = ["ENCODING", "SEPARATOR", "COLUMNS", "DECIMAL_COMMA", "BLANK_ROWS", "CHANNELS"];
        assert_eq!(codes, expected, "{verb}");
    }
    let percent = |row: &str| {
        let (names, value) = row.rsplit_once(',').unwrap();
        format!("{names},{}\n", 100.0 * value.parse::<f64>().unwrap())
    };
    write(dir, "bad.csv", &(HEAD.to_owned() + &rows("R", 0.5).lines().map(percent).collect::<String>()));
    let place = "measurement bad.csv: line 2, material resin, channel R, 0.5 mm: values up to";
    fails_line(dir, "measure bad.csv --dictionary grid", &[place, "linear radiance factors"]);
}

/// A dictionary may spell the names of its colours in another way than the measurement.
#[test]
fn dictionary_may_spell_colours_differently() {
    let dir = folder();
    let scene = "[[channel]]\nname = 'red'\nrho_light = 0.98\nrho_dark = 0.02\n\
                 [[layer]]\nname = 'resin'\nsample = true\n";
    write(dir.path(), "scene.toml", scene);
    write(dir.path(), "grid.toml", &format!("scene = 'scene.toml'\n{GRID}"));
    assert_eq!(run_line(dir.path(), "submit grid.toml -q").code, 0);
    for channel in ["red", "Red", "R"] {
        write(dir.path(), "m.csv", &(HEAD.to_owned() + &rows(channel, 0.5)));
        let ran = run_line(dir.path(), "fit m.csv --dictionary grid --json");
        assert_eq!(ran.code, 0, "{channel}: {}", ran.stdout);
        assert_eq!(json(&ran, "fit")["materials"][0]["channels"][0]["channel"], "R");
    }
    write(dir.path(), "m.csv", &(HEAD.to_owned() + &rows("G", 0.5)));
    let message = "channel = G is not valid: the dictionary has red";
    fails_line(dir.path(), "fit m.csv --dictionary grid", &[message]);
}

#[test]
fn file_is_checked_without_a_farm() {
    let dir = folder();
    write(dir.path(), "m.csv", &(HEAD.to_owned() + &rows("R", 0.5)));
    let ran = run_line(dir.path(), "check m.csv");
    assert_eq!((ran.code, ran.stderr.as_str()), (0, ""), "{}", ran.stdout);
    assert!(ran.stdout.contains("nothing is wrong with it that can be seen"), "{}", ran.stdout);
    let checked = json(&run_line(dir.path(), "check m.csv --json"), "check");
    let profile = &checked["materials"][0]["profiles"][0];
    assert_eq!((&profile["channel"], &profile["thickness_mm"]), (&"R".into(), &0.5.into()));
    assert_eq!(profile["x_mm"].as_array().unwrap().len(), profile["values"].as_array().unwrap().len());
    assert!(profile["std_errors"].is_null() && profile["origin_mm"].is_null(), "{profile}");
    assert_eq!(checked["notes"].as_array().unwrap().len(), 0);
    // Noted: a channel in small letters. Refused: no file.
    write(dir.path(), "m.csv", &(HEAD.to_owned() + &rows("r", 0.5)));
    let noted = run_line(dir.path(), "check m.csv");
    assert!(noted.stderr.starts_with("farmctl: note: m.csv: "), "{}", noted.stderr);
    assert!(noted.stdout.contains("1 note, above"), "{}", noted.stdout);
    fails(dir.path(), &["check", "none.csv"], &["measurement none.csv: No such file"]);
}

/// Shape and data of an npy file.
fn array(archive: &mut zip::ZipArchive<std::fs::File>, name: &str) -> (Vec<usize>, Vec<u8>) {
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut archive.by_name(name).unwrap(), &mut bytes).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    let end = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let head = String::from_utf8(bytes[10..end].to_vec()).unwrap();
    let shape = head.split_once("'shape': (").unwrap().1.split_once(')').unwrap().0;
    let sides = shape.split(',').filter_map(|side| side.trim().parse().ok()).collect();
    (sides, bytes[end..].to_vec())
}

/// Profiles of the responses are exported with the varied quantity, at the nodes where they were traced.
#[test]
fn responses_are_exported_with_their_variant() {
    let dir = folder();
    let scene = "[[layer]]\nname = 'gel'\nior = 1.33\nthickness_mm = { value = 0.02, std_error = 0.02 }\n\
                 [[layer]]\nname = 's'\nsample = true\nroughness = 0.05\n[light]\nring_deg = [40, 50]\nstd_error_deg = 1\n";
    write(dir.path(), "scene.toml", scene);
    let axes =
        "sigma_t_per_mm = [4, 6, 8]\nalbedo = [0.9, 0.99]\ng = [0.4]\nthickness_mm = [1]\nwalks = 1000\n";
    write(dir.path(), "varied.toml", &format!("scene = 'scene.toml'\n{axes}"));
    assert_eq!(run(dir.path(), &["submit", "varied.toml", "-q"]).code, 0);
    let ran = run_line(dir.path(), "export varied --responses");
    assert_eq!((ran.code, ran.stderr.as_str()), (0, ""));
    let rows: Vec<Vec<&str>> = ran.stdout.lines().map(|row| row.split(',').collect()).collect();
    assert_eq!(rows[0][..6], ["record", "quantity", "step", "unit", "sigma_t_per_mm", "albedo"]);
    // Two steps of the gel and of the ring, at 4 and 8 /mm; 6 records of the axes come before.
    assert_eq!(rows.len(), 1 + 4 * 2 * 2 * 3 * 360);
    assert_eq!(rows[1][..6], ["6", "gel thickness", "-0.015", "mm", "4", "0.9"]);
    assert_eq!(rows[rows.len() - 1][..6], ["21", "ring angle", "4", "°", "8", "0.99"]);

    assert_eq!(run_line(dir.path(), "export varied --responses --albedo 0.9 --npz a.npz").code, 0);
    let mut archive = zip::ZipArchive::new(std::fs::File::open(dir.path().join("a.npz")).unwrap()).unwrap();
    let (shape, values) = array(&mut archive, "value.npy");
    assert_eq!(shape, [4, 1, 2, 1, 1, 1, 3, 360]);
    let of_rows = rows[1..].iter().filter(|row| row[5] == "0.9").map(|row| row[11].parse::<f32>().unwrap());
    assert_eq!(values, of_rows.flat_map(f32::to_le_bytes).collect::<Vec<u8>>());
    let (shape, steps) = array(&mut archive, "step.npy");
    assert_eq!((shape, steps), (vec![4], [-0.015, 0.08, -4.0, 4.0_f64].map(f64::to_le_bytes).concat()));
    let about: Value = serde_json::from_reader(archive.by_name("about.json").unwrap()).unwrap();
    assert_eq!((&about["axes"][0], &about["variants"][2]["unit"]), (&"variant".into(), &"°".into()));

    let line = run_line(dir.path(), "export varied --responses --sigma-t 8 --albedo 0.9 --json").stdout;
    let first: Value = serde_json::from_str(line.lines().next().unwrap()).unwrap();
    let data = &first["data"];
    assert_eq!((&data["quantity"], &data["step"]), (&"gel thickness".into(), &(-0.015).into()));
    let wrong = "export varied --responses --sigma-t 6";
    fails_line(dir.path(), wrong, &["sigma_t = 6", "the dictionary has 4, 8"]);
    let message = "the dictionary has no responses: its scene is exact";
    fails_line(farm().path(), "export grid --responses", &[message]);
}

/// The arrays for NumPy hold the values of the exported rows.
#[test]
fn numpy_arrays_hold_the_exported_rows() {
    let farm = farm();
    let dir = farm.path();
    let ran = run_line(dir, "export grid --npz a.npz --albedo 0.999");
    assert_eq!((ran.code, ran.stdout.as_str(), ran.stderr.as_str()), (0, "", ""));
    let mut archive = zip::ZipArchive::new(std::fs::File::open(dir.join("a.npz")).unwrap()).unwrap();
    let f32s = |bytes: Vec<u8>| -> Vec<f32> {
        bytes.chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
    };
    let (shape, values) = array(&mut archive, "value.npy");
    // The rows are ordered by σ_t, g, thickness, albedo, channel, pixel.
    assert_eq!(shape, [1, 2, 1, 2, 1, 3, 360]);
    let (_, errors) = array(&mut archive, "std_error.npy");
    let rows = run_line(dir, "export grid --albedo 0.999").stdout;
    let of_rows: Vec<[f32; 2]> = rows
        .lines()
        .skip(1)
        .map(|row| {
            let cells: Vec<&str> = row.split(',').collect();
            [cells[8], cells[9]].map(|cell| cell.parse().unwrap())
        })
        .collect();
    let of_arrays: Vec<[f32; 2]> = f32s(values).into_iter().zip(f32s(errors)).map(|(v, e)| [v, e]).collect();
    assert_eq!(of_arrays, of_rows);
    let (shape, sigma_t) = array(&mut archive, "sigma_t_per_mm.npy");
    assert_eq!((shape, sigma_t), (vec![2], [4.0_f64, 6.0].map(f64::to_le_bytes).concat()));
    let (shape, channels) = array(&mut archive, "channel.npy");
    assert_eq!((shape, channels), (vec![3], b"R\0\0\0G\0\0\0B\0\0\0".to_vec()));
    let about: Value = serde_json::from_reader(archive.by_name("about.json").unwrap()).unwrap();
    assert_eq!(about["dictionary"]["name"], "grid");
    assert_eq!(
        (&about["units"]["value"], &about["axes"][1]),
        (&"radiance factor".into(), &"sigma_t_per_mm".into())
    );

    let line = "export grid --npz b.npz --albedo 0.3";
    fails_line(dir, line, &["albedo = 0.3", "the dictionary has 0.9, 0.999"]);
    fails_line(dir, "export grid --npz none/b.npz", &["output none/b.npz", "No such file"]);
    assert!(!dir.join("b.npz").exists());
}
