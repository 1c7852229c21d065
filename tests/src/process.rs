//! Runs the built programs as users run them, with signals and logs.

use std::fs::File;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU16, Ordering};
use std::time::Duration;

pub use rustix::process::Signal;
use tokio::time::Instant;

use crate::memory_group::MemoryGroup;
use crate::usage::Usage;
use crate::wall_clock::WallClock;

/// Time limit of anything that needs no tracing.
pub const SOON: Duration = Duration::from_secs(30);
/// Time limit of a dictionary.
pub const LONG: Duration = Duration::from_mins(3);
/// Pause between two checks.
const LOOK: Duration = Duration::from_millis(20);

/// Calls `look` until it returns something, and fails after `limit`.
///
/// # Panics
/// If it returns nothing in time.
pub fn wait_for<T>(what: &str, limit: Duration, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + limit;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "timeout of {limit:?}: {what}");
        std::thread::sleep(LOOK);
    }
}

/// A free port below the range of outgoing connections, one of which could otherwise take it while its owner restarts.
///
/// # Panics
/// If there is no free port.
pub fn free_port() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    for _ in 0..1000 {
        let offset = (std::process::id() as u16).wrapping_mul(101) % 10_000;
        let port = 20_000 + (offset + NEXT.fetch_add(1, Ordering::Relaxed)) % 12_000;
        if TcpListener::bind(("127.0.0.1", port)).is_ok() {
            return port;
        }
    }
    panic!("there is no free port");
}

/// The program of this name that was built with the tests: `cargo test --workspace` builds all programs. With
/// `FARM_TEST_PROGRAMS` it is one of that folder, so that long tests can continue while sources change.
///
/// # Panics
/// If it is missing, or older than a source file.
pub fn program(name: &str) -> PathBuf {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(programs).join(name)
}

/// A copy of a program in a folder, for other users: the build folder may be closed to them. Another process writes it: a
/// file that this one has open cannot be run while a program that another thread has just started still holds it.
///
/// # Panics
/// If it cannot be written.
pub fn copied_program(name: &str, folder: &Path) -> PathBuf {
    let copy = folder.join(name);
    let copied = Command::new("cp").args([&program(name), &copy]).status();
    assert!(copied.is_ok_and(|status| status.success()), "{} is copied", copy.display());
    copy
}

fn programs() -> PathBuf {
    if let Some(folder) = std::env::var_os("FARM_TEST_PROGRAMS") {
        return folder.into();
    }
    // The test's path is …/target/<profile>/deps/<name>.
    let test = std::env::current_exe().expect("the test knows its path");
    let folder = test.ancestors().nth(2).expect("tests lie two folders deep").to_owned();
    for name in ["farmctl", "farm-coordinator", "farm-worker"] {
        let state = stale(&folder.join(name));
        let release = if cfg!(debug_assertions) { "" } else { " --release" };
        assert!(
            state.is_none(),
            "{} {}: run `cargo build --workspace --bins{release}`",
            name,
            state.unwrap_or_default()
        );
    }
    folder
}

/// The defect of a built program: it is missing, or one of its sources is newer. Cargo lists these next to it.
fn stale(program: &Path) -> Option<String> {
    let changed = |path: &Path| path.metadata().and_then(|data| data.modified()).ok();
    let Some(built) = changed(program) else {
        return Some(format!("is not in {}", program.parent()?.display()));
    };
    let list = std::fs::read_to_string(program.with_extension("d")).ok()?;
    let newer = list.split_whitespace().skip(1).find(|source| changed(Path::new(source)) > Some(built))?;
    Some(format!("is older than {newer}"))
}

/// `farmctl` in a folder, without settings from the environment.
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

/// Environment of programs, if it differs from that of the tests.
#[derive(Debug, Default)]
pub(crate) struct Surroundings {
    pub wall_clock: Option<WallClock>,
    pub memory: Option<MemoryGroup>,
}

impl Surroundings {
    /// A command with these arguments, not yet started.
    pub fn command(&self, name: &str, args: &[&str]) -> Command {
        let program = program(name);
        let mut command = match &self.memory {
            Some(group) => group.command(program.as_os_str()),
            None => Command::new(program),
        };
        // Acknowledged results are logged at this level.
        command.env("FARM_LOG", "info,farm_worker=debug").args(args);
        command.envs(self.wall_clock.iter().flat_map(WallClock::environment));
        command
    }
}

/// A running program. It is killed when dropped; if the test has failed, its log is shown.
#[derive(Debug)]
pub struct Process {
    name: String,
    child: Child,
    log: PathBuf,
}

impl Process {
    /// Starts a program whose standard error goes to a file.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start(name: &str, args: &[&str], log: &Path) -> Self {
        Self::spawn(name, &mut Surroundings::default().command(name, args), log)
    }

    /// Starts a command with arguments, without settings from the environment.
    ///
    /// # Panics
    /// If it does not start.
    pub fn spawn(name: &str, command: &mut Command, log: &Path) -> Self {
        Self::spawn_into(name, command, log, Stdio::null())
    }

    /// Starts a command with a place for standard output.
    ///
    /// # Panics
    /// If it does not start.
    pub fn spawn_into(name: &str, command: &mut Command, log: &Path, output: impl Into<Stdio>) -> Self {
        let file = File::options().create(true).append(true).open(log).expect("the log can be written to");
        let mut process = Self::logging_to(name, command.stdout(output), file);
        log.clone_into(&mut process.log);
        process
    }

    /// Starts a command with standard error to `log`, which may be a pipe without a reader.
    ///
    /// # Panics
    /// If it does not start.
    pub fn logging_to(name: &str, command: &mut Command, log: impl Into<Stdio>) -> Self {
        for variable in ["FARM_SERVER", "FARM_ACCESS", "FARM_DATA", "FARM_LISTEN", "FARM_METRICS"] {
            command.env_remove(variable);
        }
        let child = command.stdin(Stdio::null()).stderr(log).spawn().expect("the program starts");
        Self { name: name.to_owned(), child, log: PathBuf::new() }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn signal(&self, signal: Signal) {
        let id = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(id, signal).expect("the process is there");
    }

    /// Sends SIGHUP, as when its terminal is closed.
    ///
    /// # Panics
    /// If the tests themselves run with SIGHUP ignored, which programs inherit.
    pub fn hang_up(&self) {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.id())).unwrap_or_default();
        let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
        let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
        assert_eq!(ignored & 1, 0, "SIGHUP is ignored here, as under nohup: run the tests without it");
        self.signal(Signal::HUP);
    }

    /// Sends SIGKILL, and waits until the process is gone.
    pub fn kill(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Waits for the end and returns the exit code; -1 after a signal.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn exit_within(&mut self, limit: Duration) -> i32 {
        let status = wait_for(&format!("{} ends", self.name), limit, || {
            self.child.try_wait().expect("it can be waited for")
        });
        status.code().unwrap_or(-1)
    }

    /// Sends SIGTERM and returns the exit code.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn terminate(&mut self, limit: Duration) -> i32 {
        self.signal(Signal::TERM);
        self.exit_within(limit)
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("it can be waited for").is_none()
    }

    /// Standard error so far.
    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Waits until its standard error contains this text.
    ///
    /// # Panics
    /// If it does not appear soon.
    pub fn wait_for_log(&self, what: &str) {
        wait_for(what, SOON, || self.log().contains(what).then_some(()));
    }

    /// Its use of processor, memory and files; None if it has ended.
    pub fn usage(&self) -> Option<Usage> {
        Usage::of(self.id())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
        if std::thread::panicking() {
            let log = self.log();
            let lines: Vec<_> = log.lines().collect();
            eprintln!("--- the last lines of {} ({}):", self.name, self.log.display());
            lines[lines.len().saturating_sub(25)..].iter().for_each(|line| eprintln!("{line}"));
        }
    }
}
