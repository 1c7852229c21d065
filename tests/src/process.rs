//! The built programs, run as users run them.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;

/// The program of this name, built by cargo in the profile of the tests.
///
/// # Panics
/// If it cannot be built.
pub fn program(name: &str) -> PathBuf {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| build(&["--workspace", "--bins"])).join(name)
}

/// The coordinator alone: in the profile of benchmarks the others take long to build.
///
/// # Panics
/// If it cannot be built.
pub fn coordinator() -> PathBuf {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| build(&["--package", "farm-coordinator"])).join("farm-coordinator")
}

/// Builds and tells the folder with the programs.
fn build(what: &[&str]) -> PathBuf {
    let mut build = Command::new(env!("CARGO"));
    build.current_dir(crate::reference::root()).args(["build", "--quiet"]).args(what);
    if !cfg!(debug_assertions) {
        build.arg("--release");
    }
    let built = build.output().expect("cargo runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    // This test is …/target/<profile>/deps/<name>.
    let test = std::env::current_exe().expect("the test knows its path");
    test.ancestors().nth(2).expect("tests lie two folders deep").to_owned()
}

/// `farmctl` in a folder, without settings from the surroundings.
pub fn farmctl(folder: &Path) -> Command {
    let mut command = Command::new(program("farmctl"));
    command.current_dir(folder).env_remove("FARM_SERVER").env_remove("FARM_DATA").env_remove("FARM_LOG");
    command.stdin(Stdio::null());
    command
}

/// Exit code, standard output, standard error.
#[derive(Debug)]
pub struct Ran {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

/// Runs `farmctl` with arguments in a folder.
///
/// # Panics
/// If it does not start.
pub fn run(folder: &Path, args: &[&str]) -> Ran {
    farmctl(folder).args(args).output().expect("farmctl starts").into()
}

/// A process that is killed when the test ends, however it ends.
#[derive(Debug)]
pub struct Killed(pub Child);

impl Drop for Killed {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
