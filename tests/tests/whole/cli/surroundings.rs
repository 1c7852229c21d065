//! Outputs that cannot be written to, and file names that are not UTF-8.

use std::ffi::OsStr;
use std::fs::File;
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::process::Command;

use farm_tests::cli::folder;
use farm_tests::process::{Ran, farmctl, program};

fn full() -> File {
    File::options().write(true).open("/dev/full").expect("Linux has /dev/full")
}

/// An error that cannot be printed ends the program without a panic.
#[test]
fn unprintable_error_causes_no_panic() {
    let dir = folder();
    let ran: Ran =
        farmctl(dir.path()).args(["--json", "check", "none.csv"]).stdout(full()).output().unwrap().into();
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    assert!(ran.stderr.starts_with("farmctl: measurement none.csv: No such file"), "{}", ran.stderr);
    let codes = [
        ("farmctl", "check"),
        ("farm-coordinator", "--listen=0.0.0.0:0"),
        ("farm-worker", "--server=no url"),
    ]
    .map(|(name, argument)| {
        let mut command = Command::new(program(name));
        command.current_dir(dir.path()).arg(argument).env("FARM_LOG", "none such").stderr(full());
        command.output().unwrap().status.code()
    });
    // The command line refuses `check` without a file.
    assert_eq!(codes, [Some(2), Some(1), Some(1)]);
    let ran: Ran = farmctl(dir.path()).args(["check", "none.csv"]).stderr(full()).output().unwrap().into();
    assert_eq!(ran.code, 1);
}

/// File names that are not UTF-8 are accepted.
#[test]
fn non_utf_8_names_are_accepted() {
    let dir = folder();
    let run = |args: &[&[u8]]| -> Ran {
        farmctl(dir.path()).args(args.iter().map(|a| OsStr::from_bytes(a))).output().unwrap().into()
    };
    for json in [&b"--quiet"[..], b"--json"] {
        let ran = run(&[json, b"capture", b"--board", b"b\xff.svg"]);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        assert!(ran.stdout.contains("b\u{fffd}.svg"), "{}", ran.stdout);
    }
    assert!(Path::new(dir.path()).join(OsStr::from_bytes(b"b\xff.svg")).exists());
    std::fs::write(dir.path().join(OsStr::from_bytes(b"p\xff.dng")), "no photograph").unwrap();
    let ran = run(&[b"--json", b"capture", b"--check", b"p\xff.dng"]);
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    assert!(ran.stdout.contains("\"photograph\":\"p\u{fffd}.dng\""), "{}", ran.stdout);
}
