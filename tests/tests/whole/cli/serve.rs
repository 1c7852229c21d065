//! `farmctl serve`: a farm for other programs of the machine.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Stdio};

use farm_tests::cli::{GRID, fails, folder, json, write};
use farm_tests::process::{Ran, SOON, farmctl, run, wait_for};

/// A farm that serves a folder until its input ends, and its address.
fn serve(folder: &Path) -> (Child, String) {
    let mut command = farmctl(folder);
    command.args(["--json", "serve", "--until-input-ends"]).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    let served = json(&Ran { code: 0, stdout: line, stderr: String::new() }, "serve");
    (child, served["address"].as_str().unwrap().to_owned())
}

fn address(folder: &Path) -> Option<String> {
    let ran = run(folder, &["--json", "status"]);
    json(&ran, "status")["address"].as_str().map(str::to_owned)
}

/// A served folder can be used by other commands, and the next `serve` takes it over.
#[test]
fn served_folder_is_shared_and_taken_over() {
    let folder = folder();
    write(folder.path(), "grid.toml", GRID);
    let (mut first, at) = serve(folder.path());
    let (mut second, neighbours) = serve(folder.path());
    assert_eq!(neighbours, at, "a folder has one farm");
    let submitted = run(folder.path(), &["submit", "grid.toml"]);
    assert!(submitted.stdout.starts_with("grid: 8 records are done"), "{}", submitted.stderr);
    assert_eq!(address(folder.path()), Some(at.clone()));

    first.kill().unwrap();
    first.wait().unwrap();
    let next = wait_for("the other one serves", SOON, || {
        let found = std::fs::read_to_string(folder.path().join("farm-data/coordinator.addr")).ok()?;
        (format!("http://{found}") != at && !found.is_empty()).then_some(found)
    });
    assert_eq!(address(folder.path()), Some(format!("http://{next}")));

    drop(second.stdin.take());
    assert_eq!(second.wait().unwrap().code(), Some(0), "it ends with its input");
    assert!(!folder.path().join("farm-data/coordinator.addr").exists());
    assert_eq!(json(&run(folder.path(), &["--json", "show", "grid"]), "show")["records_done"], 8);
}

/// `serve` with the address of a farm that runs already is refused.
#[test]
fn running_farm_elsewhere_is_not_served() {
    let folder = folder();
    let (mut child, at) = serve(folder.path());
    fails(folder.path(), &["serve", "--server", &at], &["runs already", "without --server"]);
    drop(child.stdin.take());
    assert!(child.wait().unwrap().success());
}
