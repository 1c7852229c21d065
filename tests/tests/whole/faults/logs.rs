//! Logs that are not read or cannot be written: programs continue without them.

use std::fs::File;
use std::io::{PipeReader, PipeWriter, Write as _, pipe};
use std::process::{Command, Stdio};

use farm_tests::cli::GRID;
use farm_tests::process::{LONG, Process, SOON, farmctl, free_port, program, wait_for};

/// A full pipe whose reader does not read.
fn unread() -> (PipeReader, PipeWriter) {
    let (reader, mut writer) = pipe().unwrap();
    rustix::io::ioctl_fionbio(&writer, true).unwrap();
    while writer.write(&[b'-'; 512]).is_ok() {}
    rustix::io::ioctl_fionbio(&writer, false).unwrap();
    (reader, writer)
}

/// Computes a dictionary with programs that all use this log, and checks that they exit with code 0.
fn works_and_ends(log: impl Fn() -> Stdio) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("grid.toml"), GRID).unwrap();
    let address = format!("127.0.0.1:{}", free_port());
    let url = format!("http://{address}");
    let start = |name: &str, args: &[&str]| {
        let mut command = Command::new(program(name));
        Process::logging_to(name, command.current_dir(folder.path()).args(args), log())
    };
    let mut coordinator = start("farm-coordinator", &["--data", "data", "--listen", &address]);
    wait_for("the coordinator listens", SOON, || std::net::TcpStream::connect(&address).ok());
    let mut worker = start("farm-worker", &["--server", &url]);
    let mut command = farmctl(folder.path());
    command.args(["--server", &url, "submit", "grid.toml", "--wait"]);
    let mut submit = Process::logging_to("farmctl", &mut command, log());
    assert_eq!(submit.exit_within(LONG), 0);
    assert_eq!((worker.terminate(SOON), coordinator.terminate(SOON)), (0, 0));
    let mut command = farmctl(folder.path());
    command.args(["--data", "data", "submit", "grid.toml", "--name", "again"]);
    assert_eq!(Process::logging_to("farmctl", &mut command, log()).exit_within(LONG), 0);
}

/// A log whose reader has ended, one on a full disk and one that is not read stop no program.
#[test]
fn logs_that_take_nothing_stop_no_program() {
    works_and_ends(|| pipe().unwrap().1.into());
    works_and_ends(|| File::options().write(true).open("/dev/full").unwrap().into());
    let (_reader, full) = unread();
    works_and_ends(|| full.try_clone().unwrap().into());
}
