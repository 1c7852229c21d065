//! Runs `farmctl` in temporary folders, for the tests of the command line.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::Stdio;

use serde_json::Value;

use crate::process::{Ran, farmctl, run};

/// A grid of 8 records that takes a fraction of a second.
pub const GRID: &str = "sigma_t_per_mm = [4, 6]\nalbedo = [0.9, 0.999]\ng = [0.4]\nwalks = 5000\n";

/// An empty folder for a farm.
pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

/// Writes a file.
pub fn write(folder: &Path, name: &str, text: &str) {
    std::fs::write(folder.join(name), text).unwrap();
}

/// Gives the grid file of a captured session other axes.
pub fn set_axes(grid: &Path, axes: &str) {
    let text = std::fs::read_to_string(grid).unwrap();
    let others: Vec<_> = text.lines().filter(|line| !line.starts_with("albedo = ")).collect();
    std::fs::write(grid, axes.to_owned() + &others.join("\n")).unwrap();
}

/// A folder with the dictionary `grid`.
pub fn farm() -> tempfile::TempDir {
    let folder = folder();
    write(folder.path(), "grid.toml", GRID);
    let submitted = run(folder.path(), &["submit", "grid.toml"]);
    assert_eq!(submitted.code, 0, "{}", submitted.stderr);
    assert!(submitted.stdout.starts_with("grid: 8 records are done"), "{}", submitted.stdout);
    folder
}

/// The data of the JSON object that a command printed.
pub fn json(ran: &Ran, kind: &str) -> Value {
    let value: Value = serde_json::from_str(&ran.stdout).unwrap_or_else(|e| panic!("{e}: {}", ran.stdout));
    assert_eq!(value["api"], "farmctl/1");
    assert_eq!(value["kind"], kind, "{}{}", ran.stdout, ran.stderr);
    value["data"].clone()
}

/// The keys of an object, sorted.
pub fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<_> = value.as_object().expect("an object").keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

/// Checks that a command fails with exit code 1, with a message on standard error that contains `parts`, and without
/// output.
pub fn fails(folder: &Path, args: &[&str], parts: &[&str]) {
    let ran = run(folder, args);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, ""), "{args:?}: {}", ran.stderr);
    assert!(ran.stderr.starts_with("farmctl: "), "{args:?}: {}", ran.stderr);
    for part in parts {
        assert!(ran.stderr.contains(part), "{args:?}: {part:?} is missing from the message: {}", ran.stderr);
    }
}

/// Runs `farmctl` with the words of a line.
pub fn run_line(folder: &Path, line: &str) -> Ran {
    run(folder, &line.split_whitespace().collect::<Vec<_>>())
}

/// Like [`fails`], with the words of a line.
pub fn fails_line(folder: &Path, line: &str, parts: &[&str]) {
    fails(folder, &line.split_whitespace().collect::<Vec<_>>(), parts);
}

/// Begins to submit a grid file, and kills the command at its first line of progress, which is returned: the dictionary
/// exists then, and nothing is computed.
pub fn begin_to_submit(folder: &Path, grid: &str) -> String {
    let mut command = farmctl(folder);
    let submit = command.args(["submit", grid]).env("FARM_PACE_MS", "60000").stderr(Stdio::piped()).spawn();
    let mut submit = submit.expect("farmctl starts");
    let line = first_progress(submit.stderr.take().expect("it is piped"));
    submit.kill().expect("it still runs");
    submit.wait().unwrap();
    line
}

/// The first line of progress, after the forecast.
pub fn first_progress(stderr: impl std::io::Read) -> String {
    let lines = BufReader::new(stderr).lines().map(|line| line.expect("it is text"));
    lines.into_iter().find(|line| line.contains("of the work")).unwrap_or_default()
}

/// Rows of a profile that rises from 0.1 to 0.8, over twice the width if the slab is twice as thick.
pub fn rows(channel: &str, thickness: f64) -> String {
    let row = |i: i32| {
        let x = (f64::from(i) - 29.5) / 6.0;
        format!("resin,{channel},{thickness},{x:.5},{:.5}\n", 0.45 + 0.35 * libm::tanh(0.5 * x / thickness))
    };
    (0..60).map(row).collect()
}

/// First line of a measurement file.
pub const HEAD: &str = "material,channel,thickness_mm,x_mm,value\n";
