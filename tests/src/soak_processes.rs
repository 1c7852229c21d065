//! Coordinator and workers as processes that are killed, stopped, continued and started again.

use std::io::Write;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration;

use crate::process::{Killed, program};
use crate::statistics::Normal;
use crate::usage::Usage;

/// How long a program may take to end when it is asked to.
const END: Duration = Duration::from_secs(20);
/// Connections that stay open and say nothing, at most; the oldest are closed.
const SILENT: usize = 8;

/// What is done to the farm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    KillCoordinator,
    KillWorker,
    /// SIGSTOP, and SIGCONT after longer than a lease holds.
    StopWorker,
    StopCoordinator,
    /// SIGTERM, and a new worker in its place.
    TerminateWorker,
    /// A connection that never says a word, or stops in the middle of its greeting.
    HalfOpen,
    /// Random bytes to the port.
    Garbage,
}

impl Fault {
    /// Those of a running farm; the coordinator is killed by whoever knows when that is due.
    pub const LIST: [Self; 6] = [
        Self::KillWorker,
        Self::StopWorker,
        Self::StopCoordinator,
        Self::TerminateWorker,
        Self::HalfOpen,
        Self::Garbage,
    ];
}

/// The farm's processes.
#[derive(Debug)]
pub struct Processes {
    folder: PathBuf,
    port: u16,
    lease_s: u64,
    coordinator: Killed,
    workers: Vec<Killed>,
    silent: Vec<TcpStream>,
}

impl Processes {
    /// On a port that is free now: it must stay the same over restarts.
    ///
    /// # Panics
    /// If a program does not start.
    pub fn start(folder: &Path, workers: usize, lease_s: u64) -> Self {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        drop(listener);
        let coordinator = start_coordinator(folder, port, lease_s);
        let workers = (0..workers).map(|_| start_worker(port)).collect();
        Self { folder: folder.to_owned(), port, lease_s, coordinator, workers, silent: Vec::new() }
    }

    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Of the coordinator.
    pub fn usage(&self) -> Option<Usage> {
        Usage::of(self.coordinator.0.id())
    }

    pub fn data(&self) -> PathBuf {
        self.folder.join("data")
    }

    /// # Panics
    /// If a process has ended that nobody ended.
    pub fn assert_all_run(&mut self) {
        let coordinator = self.coordinator.0.try_wait().unwrap();
        assert_eq!(coordinator, None, "the coordinator ended by itself");
        for worker in &mut self.workers {
            assert_eq!(worker.0.try_wait().unwrap(), None, "a worker ended by itself");
        }
    }

    /// # Panics
    /// If a process does not bear it as it should.
    pub fn inflict(&mut self, fault: Fault, chance: &mut Normal) {
        let victim = (chance.uniform() * self.workers.len() as f64) as usize;
        match fault {
            Fault::KillCoordinator => {
                kill(&mut self.coordinator);
                self.coordinator = start_coordinator(&self.folder, self.port, self.lease_s);
            }
            Fault::KillWorker => {
                kill(&mut self.workers[victim]);
                self.workers[victim] = start_worker(self.port);
            }
            Fault::StopWorker => {
                let pause = Duration::from_secs(self.lease_s).mul_f64(1.0 + chance.uniform());
                pause_for(&self.workers[victim], pause);
            }
            Fault::StopCoordinator => {
                pause_for(&self.coordinator, Duration::from_secs(2).mul_f64(chance.uniform()));
            }
            Fault::TerminateWorker => {
                let ended = terminate(&mut self.workers[victim]);
                assert!(ended.success(), "a worker that was asked to leave ended with {ended}");
                self.workers[victim] = start_worker(self.port);
            }
            Fault::HalfOpen => self.say_half_a_word(chance),
            Fault::Garbage => self.send_garbage(chance),
        }
    }

    fn say_half_a_word(&mut self, chance: &mut Normal) {
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.port)) {
            let greeting = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
            let _ = stream.write_all(&greeting[..(chance.uniform() * greeting.len() as f64) as usize]);
            self.silent.push(stream);
        }
        if self.silent.len() > SILENT {
            self.silent.remove(0);
        }
    }

    fn send_garbage(&self, chance: &mut Normal) {
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.port)) {
            let bytes: Vec<u8> = (0..4096).map(|_| (256.0 * chance.uniform()) as u8).collect();
            let _ = stream.write_all(&bytes);
        }
    }

    /// Asks all to end.
    ///
    /// # Panics
    /// If one of them does not, or with an error.
    pub fn stop(mut self) {
        for process in self.workers.iter_mut().chain([&mut self.coordinator]) {
            let ended = terminate(process);
            assert!(ended.success(), "a process that was asked to end did so with {ended}");
        }
    }
}

fn start_coordinator(folder: &Path, port: u16, lease_s: u64) -> Killed {
    let listen = format!("127.0.0.1:{port}");
    let mut command = quiet("farm-coordinator", folder);
    command.args(["--listen", &listen, "--lease", &lease_s.to_string(), "--verify-share", "0.1"]);
    // Kills are many here, and jobs few: none is to be given up.
    command.args(["--max-attempts", "100", "--data"]).arg(folder.join("data"));
    Killed(command.spawn().unwrap())
}

fn start_worker(port: u16) -> Killed {
    let url = format!("http://127.0.0.1:{port}");
    let mut command = quiet("farm-worker", &std::env::temp_dir());
    command.args(["--server", &url, "--threads", "1", "--grace", "2s"]);
    Killed(command.spawn().unwrap())
}

fn quiet(name: &str, folder: &Path) -> Command {
    let mut command = Command::new(program(name));
    command
        .current_dir(folder)
        .env_clear()
        .env("FARM_LOG", "error")
        .stdin(Stdio::null())
        .stdout(Stdio::null());
    command
}

fn kill(process: &mut Killed) {
    process.0.kill().unwrap();
    process.0.wait().unwrap();
}

fn signal(process: &Killed, name: &str) {
    let sent = Command::new("kill").args([name, &process.0.id().to_string()]).status().unwrap();
    assert!(sent.success(), "{name} could not be sent");
}

fn pause_for(process: &Killed, pause: Duration) {
    signal(process, "-STOP");
    std::thread::sleep(pause);
    signal(process, "-CONT");
}

fn terminate(process: &mut Killed) -> ExitStatus {
    signal(process, "-TERM");
    let step = Duration::from_millis(20);
    for _ in 0..END.as_millis() / step.as_millis() {
        if let Some(ended) = process.0.try_wait().unwrap() {
            return ended;
        }
        std::thread::sleep(step);
    }
    panic!("a process did not end within {END:?} of SIGTERM");
}
