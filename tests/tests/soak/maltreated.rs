//! A farm whose processes are killed, stopped, continued and started again.

use std::io::{Write, pipe};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use farm_link::Link;
use farm_tests::farm::Farm;
use farm_tests::memory_group::MemoryGroup;
use farm_tests::process::{Process, Signal, program};
use farm_tests::proxy::Proxy;
use farm_tests::statistics::Normal;
use farm_tests::usage::Usage;

/// How long a worker may take to end when it is asked to.
const END: Duration = Duration::from_secs(20);
/// Connections that stay open and say nothing, at most; the oldest are closed.
const SILENT: usize = 8;
/// What coordinator and workers share once they were killed. They take about half of it; caches fill the rest.
const MEMORY_BYTES: u64 = 64 << 20;

/// What is done to the farm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// SIGKILL, and a new one whose log has no reader, in a control group with little memory.
    KillCoordinator,
    KillWorker,
    /// SIGSTOP, and SIGCONT after longer than a lease holds.
    StopWorker,
    StopCoordinator,
    /// SIGTERM, and a new worker in its place.
    TerminateWorker,
    /// SIGHUP, as when a terminal is closed, and a new worker in its place.
    HangUpWorker,
    /// A new worker in the place of one that was asked to end, with a log that has no reader any more.
    AbandonLog,
    /// The link of the worker afar is half open: no end learns that nothing arrives any more.
    FreezeLink,
    /// A connection that never says a word, or stops in the middle of its greeting.
    HalfOpen,
    /// Random bytes to the port.
    Garbage,
}

impl Fault {
    /// Those of a running farm; the coordinator is killed by whoever knows when that is due.
    pub const LIST: [Self; 9] = [
        Self::KillWorker,
        Self::StopWorker,
        Self::StopCoordinator,
        Self::TerminateWorker,
        Self::HangUpWorker,
        Self::AbandonLog,
        Self::FreezeLink,
        Self::HalfOpen,
        Self::Garbage,
    ];
}

/// A coordinator and workers.
#[derive(Debug)]
pub struct Maltreated {
    workers: Vec<Process>,
    afar: Option<(Proxy, Process)>,
    farm: Farm,
    lease_s: u64,
    silent: Vec<TcpStream>,
}

impl Maltreated {
    pub fn start(workers: usize, lease_s: u64) -> Self {
        // Kills are many here, and jobs few: none is to be given up.
        let options = ["--lease", &lease_s.to_string(), "--verify-share", "0.1", "--max-attempts", "100"];
        // A token for each, so that they check each other's results.
        let names: Vec<String> = (0..=workers).map(|n| format!("machine-{n}")).collect();
        let tokens: Vec<&str> = names.iter().map(String::as_str).collect();
        let mut farm = Farm::with_tokens(&tokens, &options);
        farm.abandon_log();
        match MemoryGroup::with_limit(MEMORY_BYTES) {
            Some(group) => farm.limit_memory(group),
            None => eprintln!("not tried: a control group with little memory cannot be made here"),
        }
        let workers = (0..workers).map(|n| worker(&farm, n)).collect();
        Self { farm, lease_s, workers, silent: Vec::new(), afar: None }
    }

    /// Lets one more worker in, by a link of its own.
    pub async fn join_from_afar(&mut self) {
        let proxy = Proxy::start(([127, 0, 0, 1], self.farm.port()).into()).await;
        let name = format!("machine-{}", self.workers.len());
        let (keys, log) = (self.farm.path(&format!("keys/{name}.toml")), self.farm.path("afar.log"));
        let (keys, url) = (keys.to_str().expect("a path of text"), proxy.url().replace("http:", "https:"));
        let args = ["--access", keys, "--server", &url, "--label", &name, "--threads", "1"];
        let worker = Process::start("farm-worker", &args, &log);
        worker.tells("joined the coordinator");
        self.afar = Some((proxy, worker));
    }

    pub fn link(&self) -> Link {
        self.farm.link()
    }

    /// Of the coordinator.
    pub fn usage(&self) -> Option<Usage> {
        self.farm.coordinator().usage()
    }

    /// The most that coordinator and workers had together, where they have a group of their own.
    pub fn peak_bytes(&self) -> Option<u64> {
        self.farm.memory().map(MemoryGroup::peak_bytes)
    }

    pub fn database(&self) -> PathBuf {
        self.farm.database()
    }

    /// # Panics
    /// If a process has ended that nobody ended.
    pub fn assert_all_run(&mut self) {
        assert!(self.farm.coordinator_runs(), "the coordinator ended by itself");
        let afar = self.afar.iter_mut().map(|(_, worker)| worker);
        assert!(self.workers.iter_mut().chain(afar).all(Process::is_running), "a worker ended by itself");
    }

    /// # Panics
    /// If a process does not bear it as it should.
    pub fn inflict(&mut self, fault: Fault, chance: &mut Normal) {
        let victim = (chance.uniform() * self.workers.len() as f64) as usize;
        match fault {
            Fault::KillCoordinator => {
                self.farm.kill_coordinator();
                self.farm.start_coordinator();
            }
            Fault::KillWorker => {
                self.workers[victim].kill();
                self.workers[victim] = worker(&self.farm, victim);
            }
            Fault::StopWorker => {
                let pause = Duration::from_secs(self.lease_s).mul_f64(1.0 + chance.uniform());
                pause_for(&self.workers[victim], pause);
            }
            Fault::StopCoordinator => {
                pause_for(self.farm.coordinator(), Duration::from_secs(2).mul_f64(chance.uniform()));
            }
            Fault::TerminateWorker => {
                assert_eq!(self.workers[victim].terminate(END), 0, "a worker that was asked to leave");
                self.workers[victim] = worker(&self.farm, victim);
            }
            Fault::HangUpWorker => {
                self.workers[victim].hang_up();
                assert_eq!(self.workers[victim].exit_within(END), 0, "a worker that was hung up on");
                self.workers[victim] = worker(&self.farm, victim);
            }
            Fault::AbandonLog => {
                assert_eq!(self.workers[victim].terminate(END), 0, "a worker that was asked to leave");
                self.workers[victim] = worker_without_log(&self.farm, victim);
            }
            Fault::FreezeLink => self.afar.iter().for_each(|(proxy, _)| proxy.freeze()),
            Fault::HalfOpen => self.say_half_a_word(chance),
            Fault::Garbage => self.send_garbage(chance),
        }
    }

    fn say_half_a_word(&mut self, chance: &mut Normal) {
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.farm.port())) {
            let greeting = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
            let _ = stream.write_all(&greeting[..(chance.uniform() * greeting.len() as f64) as usize]);
            self.silent.push(stream);
        }
        if self.silent.len() > SILENT {
            self.silent.remove(0);
        }
    }

    fn send_garbage(&self, chance: &mut Normal) {
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.farm.port())) {
            let bytes: Vec<u8> = (0..4096).map(|_| (256.0 * chance.uniform()) as u8).collect();
            let _ = stream.write_all(&bytes);
        }
    }

    /// Asks all to end.
    ///
    /// # Panics
    /// If one of them does not, or with an error.
    pub fn stop(&mut self) {
        // It may be waiting for a link that is dead.
        if let Some((_, mut worker)) = self.afar.take() {
            worker.kill();
        }
        for mut worker in self.workers.drain(..) {
            assert_eq!(worker.terminate(END), 0, "a worker that was asked to end");
        }
        assert_eq!(self.farm.stop_coordinator(), 0, "a coordinator that was asked to end");
    }
}

fn worker(farm: &Farm, number: usize) -> Process {
    let name = format!("machine-{number}");
    farm.worker_with(&format!("keys/{name}.toml"), &name, &["--grace", "2s"])
}

/// The same with a log whose reader has ended.
fn worker_without_log(farm: &Farm, number: usize) -> Process {
    let name = format!("machine-{number}");
    let mut command = Command::new(program("farm-worker"));
    command.arg("--access").arg(farm.path(&format!("keys/{name}.toml")));
    command.args(["--label", &name, "--threads", "1", "--grace", "2s"]);
    let (_, log) = pipe().expect("there can be another pipe");
    Process::logging_to("farm-worker", &mut command, log)
}

fn pause_for(process: &Process, pause: Duration) {
    process.signal(Signal::STOP);
    std::thread::sleep(pause);
    process.signal(Signal::CONT);
}
