//! Ctrl-C in a command that only watches: the command ends, the farm continues.

use std::process::Stdio;

use farm_tests::farm::Farm;
use farm_tests::process::{Ran, SOON, Signal, wait_for};
use rustix::process::{Pid, kill_process};

use super::LONG_JOBS;

/// Starts a command, interrupts it as soon as it handles Ctrl-C, and waits for its end.
fn interrupted(farm: &Farm, args: &[&str]) -> Ran {
    let command = farm.command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for("the command handles Ctrl-C", SOON, || handles_interrupt(command.id()).then_some(()));
    kill_process(Pid::from_child(&command), Signal::INT).unwrap();
    command.wait_with_output().unwrap().into()
}

/// Whether the process has a handler for SIGINT.
fn handles_interrupt(id: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{id}/status")).unwrap();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
    let signals = u64::from_str_radix(caught.trim(), 16).unwrap();
    signals >> (Signal::INT.as_raw() - 1) & 1 == 1
}

/// After Ctrl-C the message states that the farm continues, and the exit code is 130.
#[test]
fn ctrl_c_reports_that_the_farm_continues() {
    let farm = Farm::start(&[]);
    farm.submit("grid", LONG_JOBS);
    let file = farm.folder().join("grid.toml");
    let ran = interrupted(&farm, &["submit", file.to_str().unwrap(), "--wait"]);
    assert_eq!(ran.code, 130, "{}", ran.stderr);
    for part in ["the farm continues", "`farmctl watch grid`", "`farmctl cancel grid`"] {
        assert!(ran.stdout.contains(part), "{}", ran.stdout);
    }
    let ran = interrupted(&farm, &["wait", "grid"]);
    assert_eq!((ran.code, ran.stderr.as_str()), (130, "farmctl: interrupted\n"));
    assert_eq!(interrupted(&farm, &["watch", "grid"]).code, 130);
    assert_eq!(farm.show("grid")["state"], "running");
}
