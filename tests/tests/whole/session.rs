//! From photographs to media: `farmctl capture` and `farmctl measure` with the example session.

mod bands;
mod media;

use std::path::{Path, PathBuf};

use farm_tests::cli::{fails, folder, json, keys, set_axes, write};
use farm_tests::process::{Ran, run};
use farm_tests::reference::root;
use serde_json::Value;

const FILES: [&str; 6] =
    ["grid.toml", "measurements.csv", "report.html", "report.json", "scene.toml", "session.json"];

fn session() -> PathBuf {
    root().join("examples/session/session.toml")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("paths of tests are text")
}

/// A copy of the example that can be modified.
fn copy() -> tempfile::TempDir {
    let folder = folder();
    for entry in std::fs::read_dir(session().parent().unwrap()).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
    }
    folder
}

/// Captures the session of a folder into its folder `out`.
fn captured(folder: &Path, args: &[&str]) -> Ran {
    let captured = run(folder, &[&["capture", "session.toml", "-o", "out"], args].concat());
    assert_eq!(captured.code, 0, "{}", captured.stderr);
    captured
}

/// Measures the folder `out`.
fn measured(folder: &Path, args: &[&str]) -> Value {
    let measured = run(folder, &[&["measure", "out", "--json"], args].concat());
    assert_eq!(measured.code, 0, "{}", measured.stderr);
    json(&measured, "measure")
}

fn read_json(file: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The truth is that of tests/examples/session.rs: ρ of the scene `lab`, 26 pixels per millimetre, lenses that blur
/// by 36, 32 and 35 µm behind pixels of 1/26 mm. A second run writes the same bytes.
#[test]
fn example_session_gives_the_true_profiles() {
    let folder = folder();
    let captured = run(folder.path(), &["capture", text(&session()), "-o", "white", "--json"]);
    assert_eq!(captured.code, 0, "{}", captured.stderr);
    let data = json(&captured, "capture");
    assert_eq!(keys(&data), ["errors", "files", "output", "profiles", "warnings"]);
    assert_eq!(data["profiles"].as_array().unwrap().len(), 6);
    let white = folder.path().join("white");
    assert_eq!(names(&white), FILES);
    assert_eq!(names(folder.path()), ["white"], "drafts are gone");

    let scene = std::fs::read_to_string(white.join("scene.toml")).unwrap();
    let (_, under_darker_white) = scene.split_once("name = \"R (white -1 %)\"\nrho_light = ").unwrap();
    let rho: f64 = under_darker_white.lines().next().unwrap().parse().unwrap();
    // Under the paper's coat, a light side of 0.985 that appears 1 % darker has ρ = 0.980.
    assert!((0.978..0.982).contains(&rho), "{rho}");
    let session_json = read_json(&white.join("session.json"));
    let field = |path: &str| session_json.pointer(path).and_then(Value::as_f64).unwrap();
    assert!((1.0 / field("/board/mm_per_px/value") - 26.0).abs() < 0.02);
    for (channel, lens_mm, light, dark) in
        [("R", 0.036, 0.985, 0.024), ("G", 0.032, 0.972, 0.023), ("B", 0.035, 0.971, 0.026)]
    {
        let blur_mm = libm::hypot(lens_mm, 1.0 / 26.0 / 12_f64.sqrt());
        let found = field(&format!("/blur_mm/{channel}"));
        assert!((found / blur_mm - 1.0).abs() < 0.03, "{channel}: {found} {blur_mm}");
        let rho = ["light", "dark"].map(|side| field(&format!("/board/rho_{side}/{channel}/value")));
        assert!((rho[0] - light).abs() < 0.005 && (rho[1] - dark).abs() < 0.0005, "{channel}: {rho:?}");
    }
    assert_eq!(session_json["inputs"].as_array().unwrap().len(), 14);
    let grid = farm_lab::grid_file::read_grid(&white.join("grid.toml")).unwrap();
    assert_eq!(grid.thickness_mm(), [0.5, 1.0]);
    let measured = farm_lab::measurement_file::read_measurements(&white.join("measurements.csv")).unwrap();
    assert!(measured.notes.is_empty(), "{:?}", measured.notes);

    // Media of an earlier measurement are not those of these photographs.
    let stale = farm_lab::research_object::MEASURED_FILES;
    std::fs::create_dir(folder.path().join("again")).unwrap();
    for name in stale.iter().chain(&["session.json", "my notes.txt"]) {
        write(folder.path(), &format!("again/{name}"), "{}");
    }
    let again = run(folder.path(), &["capture", text(&session()), "-o", "again"]);
    let left = names(&folder.path().join("again"));
    assert_eq!(left.iter().filter(|name| stale.contains(&name.as_str())).count(), 0, "{left:?}");
    assert!(left.iter().any(|name| name == "my notes.txt"));
    assert!(again.stdout.contains("written to again: measurements.csv"), "{}", again.stdout);
    for name in FILES {
        let [first, second] =
            ["white", "again"].map(|f| std::fs::read(folder.path().join(f).join(name)).unwrap());
        assert!(first == second, "{name} differs");
    }
}

/// The example under a camera's names becomes a session with blanks, which `capture` names until they are filled in; then
/// the profiles are those of the example to the bit. An existing session file is kept.
#[test]
fn folder_of_photographs_becomes_a_session() {
    let folder = folder();
    let order = ["dark_1", "dark_2", "flat_1", "flat_2", "chart_1", "board_1", "board_2"];
    let slabs = ["white_05_1", "white_05_2", "white_05_3", "white_10_1", "white_10_2", "white_10_3"];
    for (i, name) in order.iter().chain(&slabs).chain(&["chart_2"]).enumerate() {
        let from = session().with_file_name(format!("{name}.dng"));
        std::fs::copy(from, folder.path().join(format!("IMG_{:04}.dng", 812 + i))).unwrap();
    }
    write(folder.path(), "IMG_0001.cr3", "not a photograph that is read");
    write(folder.path(), "notes.txt", "");
    fails(folder.path(), &["measure", "."], &["`farmctl capture --new .` makes a session file"]);
    let sorted = run(folder.path(), &["capture", "--new", ".", "--json"]);
    assert_eq!(sorted.code, 0, "{}", sorted.stderr);
    let data = json(&sorted, "new_session");
    let purposes = data["shots"].as_array().unwrap().iter().map(|shot| {
        let number: u32 = shot["name"].as_str().unwrap()[4..8].parse().unwrap();
        (number, shot["purpose"]["kind"].as_str().unwrap().to_owned(), shot["purpose"]["slab"].as_u64())
    });
    let mut purposes: Vec<_> = purposes.collect();
    purposes.sort();
    let kinds: Vec<&str> = purposes.iter().map(|(_, kind, _)| kind.as_str()).collect();
    let expected =
        [&["unused"][..], &["dark"; 2], &["flat"; 2], &["neutral"], &["bare"; 2], &["slab"; 6], &["neutral"]];
    assert_eq!(kinds, expected.concat());
    let slabs: Vec<u64> = purposes.iter().filter_map(|(_, _, slab)| *slab).collect();
    assert_eq!(slabs, [1, 1, 1, 2, 2, 2]);
    assert!(std::fs::read_to_string(folder.path().join("contact.html")).unwrap().contains("IMG_0820.dng"));

    fails(folder.path(), &["measure", "."], &["`farmctl capture ./session.toml --measure`"]);
    let blank = run(folder.path(), &["capture", "session.toml"]);
    assert_ne!(blank.code, 0);
    assert!(blank.stderr.contains("to be filled in") && blank.stderr.contains("line "), "{}", blank.stderr);
    let file = folder.path().join("session.toml");
    let mut text = std::fs::read_to_string(&file).unwrap();
    let values = [
        ("rho", "[0.956, 0.594, 0.361, 0.193, 0.090, 0.032]"),
        ("std_error", "0.005"),
        ("geometry", "\"own\""),
        ("square_mm", "20"),
        ("material", "\"white\""),
        ("thickness_mm", "0.512\nthickness_std_error_mm = 0.003"),
        ("material", "\"white\""),
        ("thickness_mm", "1.006\nthickness_std_error_mm = 0.003"),
    ];
    for (key, value) in values {
        text = text.replacen(&format!("{key} = \"?\""), &format!("{key} = {value}"), 1);
    }
    std::fs::write(&file, text).unwrap();
    let captured = run(folder.path(), &["capture", "session.toml", "-o", "out", "--json"]);
    assert_eq!(captured.code, 0, "{}", captured.stderr);
    let example = std::fs::read_to_string(session()).unwrap();
    let (before, after) = example.split_once("areas_px").unwrap();
    let (_, target) = after.split_once("[target]").unwrap();
    let plain = copy();
    std::fs::write(plain.path().join("session.toml"), [before, "\n[target]", target].concat()).unwrap();
    self::captured(plain.path(), &["-q"]);
    let profiles = [folder.path(), plain.path()]
        .map(|f| std::fs::read_to_string(f.join("out/measurements.csv")).unwrap());
    assert!(
        profiles[0]
            .lines()
            .filter(|line| !line.starts_with('#'))
            .eq(profiles[1].lines().filter(|l| !l.starts_with('#')))
    );
    let again = run(folder.path(), &["capture", "--new", "."]);
    assert!(again.code != 0 && again.stderr.contains("session.toml is not replaced"), "{}", again.stderr);
}

/// σ_t is within 5 %, with eight nodes of σ_t, one of g and 51,000 walks: the error of the whole chain.
#[test]
fn captured_folder_is_measured_and_reported() {
    let folder = copy();
    captured(folder.path(), &["-q"]);
    let axes = "sigma_t_per_mm = [4, 5.2, 6.7, 8.7, 11, 15, 20, 27]\ng = [0.4]\nwalks = 51000\n";
    set_axes(&folder.path().join("out/grid.toml"), axes);
    let data = measured(folder.path(), &[]);
    for (channel, sigma_t) in
        data["materials"][0]["channels"].as_array().unwrap().iter().zip([6.0, 9.0, 24.0])
    {
        let found = channel["refined"]["sigma_t_per_mm"].as_f64().unwrap();
        assert!((found / sigma_t - 1.0).abs() < 0.05, "{channel}: {found}");
    }
    let report = std::fs::read_to_string(folder.path().join("out/report.html")).unwrap();
    assert!(report.contains("photograph above, simulation below") && report.contains("σ_t"));
    assert!(!report.contains("Nothing is fitted yet"));
    // The scene `lab` has priors, which the report shows once, as tables.
    assert!(report.contains("gel thickness</td><td data-name=\"of\">white 0.512 mm</td>"));
    assert_eq!(report.matches("To improve: ").count(), 1);
    // The answer is kept whole in a file of its own.
    let answer = read_json(&folder.path().join("out/answer.json"));
    assert_eq!((&answer["kind"], &answer["data"]["materials"]), (&"measure".into(), &data["materials"]));
    let described = std::fs::read_to_string(folder.path().join("out/ro-crate-metadata.json")).unwrap();
    assert!(described.contains("answer.json"), "{described}");
    assert!(!report.contains("<script") && !report.contains("http://") || report.contains("www.w3.org"));
    // A second measurement uses the existing dictionary.
    assert_eq!(measured(folder.path(), &[])["materials"], data["materials"]);
    assert_eq!(data["notes"], serde_json::json!([]));
    // Sessions with another board share the dictionary, which is asked with theirs.
    assert!(data["dictionary"].as_str().unwrap().starts_with("boards-"), "{data}");
    let scene = std::fs::read_to_string(folder.path().join("out/scene.toml")).unwrap();
    assert!(scene.contains("rho_light = 0.98"), "{scene}");
    write(folder.path(), "out/scene.toml", &scene.replace("rho_light = 0.98", "rho_light = 0.96"));
    let other_board = measured(folder.path(), &[]);
    assert_eq!(other_board["dictionary"], data["dictionary"]);
    assert_ne!(other_board["materials"], data["materials"]);
    write(folder.path(), "out/scene.toml", &scene);
    fails(
        folder.path(),
        &["measure", "out/measurements.csv", "--dictionary", data["dictionary"].as_str().unwrap()],
        &["is for all boards", "measure the folder of a session"],
    );
    // A dictionary of another scene is noted, with the quantities and both values.
    let axes = "sigma_t_per_mm = [5, 7, 10, 14, 20, 28]\nalbedo = [0.995, 0.999, 0.9999]\ng = [0.4]\n";
    let other = format!("{axes}thickness_mm = [0.512, 1.006]\nwalks = 20000\n");
    write(folder.path(), "other.toml", &other);
    assert_eq!(run(folder.path(), &["submit", "other.toml", "-q"]).code, 0);
    let note = &measured(folder.path(), &["--dictionary", "other"])["notes"][0];
    assert_eq!(note["code"], "SCENE_DIFFERS");
    for difference in [
        "dictionary other has another scene than the session: ",
        "light scattered repeatedly by rough surfaces lost instead of kept",
        "gel thickness 0.02 mm instead of 0.02 ± 0.02 mm per slab",
        "rho_light of R 0.985 instead of 0.98",
    ] {
        assert!(note["text"].as_str().unwrap().contains(difference), "{note}");
    }
}

/// A copy of the example that is modified is refused with a message, and nothing is written.
fn refused(change: impl Fn(&Path), message: &[&str]) {
    let folder = copy();
    change(folder.path());
    fails(folder.path(), &["capture", "session.toml", "-o", "out"], message);
    assert!(!folder.path().join("out").exists(), "{message:?}: partial result");
}

/// Another text in the session file, in place of one that is there.
fn edited(folder: &Path, from: &str, to: &str) {
    let session = std::fs::read_to_string(folder.join("session.toml")).unwrap();
    assert!(session.contains(from), "{session}");
    write(folder, "session.toml", &session.replacen(from, to, 1));
}

/// The tests of `client/lab/src/capture/session_file` have the fields of sessions, those of `photograph` the files, and
/// `science capture` the photographs. Profiles that `measure` would refuse are not written either.
#[test]
fn invalid_sessions_are_refused_with_field() {
    type Change = fn(Vec<u8>) -> Vec<u8>;
    let swapped = |folder: &Path| edited(folder, "[0.956, 0.594,", "[0.594, 0.956,");
    refused(swapped, &["not linear", "order of the patches"]);
    // The thicker slab blurs the edge more.
    let exchanged = |folder: &Path| {
        for (from, to) in [("= 0.512", "= x"), ("= 1.006", "= 0.512"), ("= x", "= 1.006")] {
            edited(folder, from, to);
        }
    };
    let message = ["profiles of these photographs", "channel R, 0.512 mm", "their thicknesses are swapped"];
    refused(exchanged, &message);
    let other_camera = |mut bytes: Vec<u8>| {
        while let Some(at) = bytes.windows(7).position(|w| w == b"Made M1") {
            bytes[at + 6] = b'2';
        }
        bytes
    };
    let half = |bytes: Vec<u8>| bytes[..bytes.len() / 2].to_vec();
    let files: [(Change, &str); 2] = [
        (half, "photograph white_05_2.dng: the file is cut off or damaged"),
        (
            other_camera,
            "white_05_2.dng was taken with Made M2, dark_1.dng with Made M1: a session has one camera",
        ),
    ];
    for (change, message) in files {
        let spoil = |folder: &Path| {
            let file = folder.join("white_05_2.dng");
            std::fs::write(&file, change(std::fs::read(&file).unwrap())).unwrap();
        };
        refused(spoil, &[message]);
    }
}

/// Single photographs can be checked, and a board can be printed.
#[test]
fn photographs_are_checked_and_boards_printed() {
    let folder = copy();
    let good = run(folder.path(), &["capture", "--check", "board_1.dng", "white_05_1.dng"]);
    assert_eq!(good.code, 0, "{}", good.stderr);
    assert!(good.stdout.contains("board_1.dng: usable"), "{}", good.stdout);
    let bad = run(folder.path(), &["capture", "--check", "board_1.dng", "session.toml", "--json"]);
    assert_eq!(bad.code, 1, "{}", bad.stdout);
    let data = json(&bad, "check");
    assert_eq!((data["usable"].as_bool(), data["shots"][0]["usable"].as_bool()), (Some(false), Some(true)));
    assert!(data["shots"][1]["reason"].as_str().unwrap().starts_with("the file is no DNG"), "{data}");
    // Files without a black level: BlackLevel (50714) becomes DefaultScale (50718).
    for name in ["board_1.dng", "dark_1.dng", "dark_2.dng"] {
        let path = folder.path().join(name);
        let mut bytes = std::fs::read(&path).unwrap();
        let tag = [0x1a, 0xc6, 4, 0, 1, 0, 0, 0];
        let at = bytes.windows(8).position(|w| w == tag).unwrap();
        bytes[at] = 0x1e;
        std::fs::write(path, bytes).unwrap();
    }
    let unknown = run(folder.path(), &["capture", "--check", "board_1.dng"]);
    assert!(unknown.stdout.contains("`--darks` with --check"), "{}", unknown.stdout);
    let args = ["capture", "--check", "board_1.dng", "--darks", "dark_1.dng", "dark_2.dng"];
    let checked = run(folder.path(), &args);
    assert_eq!(checked.code, 0, "{}", checked.stdout);
    let brightest = |out: &str| out.split(" % of full").next().map(str::to_owned);
    assert_eq!(brightest(&checked.stdout), brightest(&good.stdout));
    for name in ["board.svg", "board.pdf"] {
        assert_eq!(run(folder.path(), &["capture", "--board", name]).code, 0);
        assert!(folder.path().join(name).metadata().unwrap().len() > 1000);
    }
    fails(folder.path(), &["capture", "--board", "board.jpg"], &["must end with .svg or .pdf"]);
}
