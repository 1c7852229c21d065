//! The built program answers.

use std::process::Command;

/// The version is the package's, and an unknown option is refused with the usage.
#[test]
fn program_has_its_version_and_usage() {
    let run = |argument: &str| {
        Command::new(env!("CARGO_BIN_EXE_farm-coordinator")).arg(argument).output().expect("it starts")
    };
    let version = run("--version");
    assert_eq!(
        String::from_utf8_lossy(&version.stdout),
        concat!("farm-coordinator ", env!("CARGO_PKG_VERSION"), "\n")
    );
    let refused = run("--frob");
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("Usage: farm-coordinator"), "{refused:?}");
}
