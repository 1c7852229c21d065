//! Scenes with uncertain quantities: the limits of scene files, and when responses can be used.

use std::path::Path;

use farm_tests::cli::{begin_to_submit, fails, fails_line, folder, run_line, write};
use farm_tests::process::run;

/// Two records of the axes; an uncertain gel thickness adds two for each of its two steps.
const GRID: &str = "scene = 'scene.toml'\nsigma_t_per_mm = [4, 8]\nalbedo = [0.9]\ng = [0.4]\nthickness_mm = [0.5]\nwalks = 1000\n";

/// A scene file of nine lines: thickness of the gel in line 4, its index in line 3, the ring's error in the last.
fn scene(ior: &str, thickness_mm: &str, roughness: &str, ring: &str) -> String {
    format!(
        "[[layer]]\nname = 'gel'\nior = {ior}\nthickness_mm = {thickness_mm}\n[[layer]]\nname = 's'\nsample = true\n\
         roughness = {roughness}\n[light]\n{ring}\n"
    )
}

fn write_files(dir: &Path, scene: &str, grid: &str) {
    write(dir, "scene.toml", scene);
    write(dir, "varied.toml", grid);
}

/// Values of uncertain quantities are refused with their key and line, the value, and the allowed values, as in the tests of
/// `optics/model/src/files/scene.rs`.
#[test]
fn impossible_uncertain_values_are_refused() {
    let dir = folder();
    let with = |thickness: &str| scene("1.33", thickness, "0", "ring_deg = [40, 50]");
    write_files(dir.path(), &with("{ std_error = 0.02 }"), GRID);
    let message = "line 4: layer[0].thickness_mm = missing is not valid";
    let parts = ["grid file varied.toml: scene file scene.toml", message];
    fails_line(dir.path(), "submit varied.toml", &parts);
    // The value of the sample's index is the grid's.
    let uncertain = with("0.02").replace("sample = true", "sample = true\nior = { std_error = 0.5 }");
    write_files(dir.path(), &uncertain, &format!("{GRID}sample_ior = [1.5]\n"));
    let message = "line 7: sample_ior = 0.25 is not valid: the response of the sample's index would be traced there: allowed are 1 to 4";
    fails(dir.path(), &["submit", "varied.toml"], &[message]);
    assert!(!dir.path().join("farm-data").exists());
}

/// Another prior makes another dictionary: it is not computed into one of the same name.
#[test]
fn other_priors_need_another_name() {
    let dir = folder();
    let with = |error: &str| {
        scene("1.33", &format!("{{ value = 0.02, std_error = {error} }}"), "0", "ring_deg = [40, 50]")
    };
    write_files(dir.path(), &with("0.02"), GRID);
    assert_eq!(run(dir.path(), &["submit", "varied.toml", "-q"]).code, 0);
    write_files(dir.path(), &with("0.01"), GRID);
    let parts = ["dictionary varied exists with another grid", "choose another name"];
    fails_line(dir.path(), "submit varied.toml", &parts);
}

/// Fits wait for the responses: with all records of the axes alone the dictionary is not complete.
#[test]
fn fits_need_all_responses() {
    let dir = folder();
    write_files(dir.path(), &scene("1.33", "0.02", "0", "ring_deg = [40, 50]"), GRID);
    assert_eq!(run(dir.path(), &["submit", "varied.toml", "--name", "exact", "-q"]).code, 0);
    // The records of the axes are reused.
    let gel = "{ value = 0.02, std_error = 0.02 }";
    write_files(dir.path(), &scene("1.33", gel, "0", "ring_deg = [40, 50]"), GRID);
    let line = begin_to_submit(dir.path(), "varied.toml");
    assert!(line.contains(", 2 of 6 records"), "{line}");
    let simulate = "simulate --sigma-t 6 --albedo 0.9 --g 0.4 --thickness 0.5 --walks 1000 --scene scene.toml \
                    --measurement m -o m.csv";
    assert_eq!(run_line(dir.path(), simulate).code, 0);
    let message = "dictionary varied is not complete: 2 of 6 records are done";
    fails(dir.path(), &["fit", "m.csv", "--dictionary", "varied"], &[message]);
}
