//! The built program answers.

use std::process::Command;

/// The version is the package's, and a misspelt verb is refused with a hint.
#[test]
fn program_has_its_version_and_hints() {
    let run = |argument: &str| {
        Command::new(env!("CARGO_BIN_EXE_farmctl")).arg(argument).output().expect("it starts")
    };
    let version = run("--version");
    assert_eq!(
        String::from_utf8_lossy(&version.stdout),
        concat!("farmctl ", env!("CARGO_PKG_VERSION"), "\n")
    );
    let refused = run("mesure");
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("measure"), "{refused:?}");
}
