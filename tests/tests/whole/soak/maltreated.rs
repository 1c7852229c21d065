//! Injects faults into a farm: its processes are killed, stopped, continued and restarted.

use std::io::Write;
use std::net::TcpStream;
use std::path::PathBuf;
use std::time::Duration;

use farm_link::Link;
use farm_tests::farm::Farm;
use farm_tests::memory_group::MemoryGroup;
use farm_tests::process::{Process, Signal};
use farm_tests::proxy::Proxy;
use farm_tests::statistics::Normal;
use farm_tests::usage::Usage;

/// Time limit for a worker to end after SIGTERM.
const END: Duration = Duration::from_secs(20);
/// Largest number of silent open connections; the oldest are closed.
const SILENT: usize = 8;
/// Memory limit of coordinator and workers after their first kill. They need about half of it; caches fill the rest.
const MEMORY_BYTES: u64 = 64 << 20;

/// A fault that is injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// SIGKILL and a restart with a log without a reader, in a control group with little memory.
    KillCoordinator,
    KillWorker,
    /// SIGSTOP, and SIGCONT after the lease has expired.
    StopWorker,
    StopCoordinator,
    /// SIGTERM, and a new worker as replacement.
    TerminateWorker,
    /// SIGHUP, as when a terminal is closed, and a new worker as replacement.
    HangUpWorker,
    /// The remote worker's connection is frozen: neither end notices that nothing arrives.
    FreezeLink,
    /// A connection that is silent, or stops in the middle of its greeting.
    HalfOpen,
    /// Random bytes to the port.
    Garbage,
}

impl Fault {
    /// Faults of a running farm; kills of the coordinator are scheduled by the test.
    pub const LIST: [Self; 8] = [
        Self::KillWorker,
        Self::StopWorker,
        Self::StopCoordinator,
        Self::TerminateWorker,
        Self::HangUpWorker,
        Self::FreezeLink,
        Self::HalfOpen,
        Self::Garbage,
    ];
}

/// A coordinator and workers.
#[derive(Debug)]
pub struct FaultyFarm {
    workers: Vec<Process>,
    afar: Option<(Proxy, Process)>,
    farm: Farm,
    lease_s: u64,
    silent: Vec<TcpStream>,
}

impl FaultyFarm {
    pub fn start(workers: usize, lease_s: u64) -> Self {
        // There are many kills and few jobs, none of which should be given up.
        let options = ["--lease", &lease_s.to_string(), "--verify-share", "0.1", "--max-attempts", "100"];
        // Separate tokens, so that a worker that is fenced off would be known.
        let names: Vec<String> = (0..=workers).map(|n| format!("machine-{n}")).collect();
        let tokens: Vec<&str> = names.iter().map(String::as_str).collect();
        let mut farm = Farm::with_tokens(&tokens, &options);
        farm.abandon_log();
        match MemoryGroup::with_limit(MEMORY_BYTES) {
            Some(group) => farm.limit_memory(group),
            None => eprintln!("SKIPPED: a control group with little memory cannot be created here"),
        }
        let workers = (0..workers).map(|n| worker(&farm, n)).collect();
        Self { farm, lease_s, workers, silent: Vec::new(), afar: None }
    }

    /// Adds a worker behind a proxy.
    pub async fn add_remote_worker(&mut self) {
        let proxy = Proxy::start(([127, 0, 0, 1], self.farm.port()).into()).await;
        let name = format!("machine-{}", self.workers.len());
        let (keys, log) = (self.farm.path(&format!("keys/{name}.toml")), self.farm.path("afar.log"));
        let (keys, url) = (keys.to_str().expect("a path of text"), proxy.url().replace("http:", "https:"));
        let args = ["--access", keys, "--server", &url, "--label", &name, "--threads", "1"];
        let worker = Process::start("farm-worker", &args, &log);
        worker.wait_for_log("joined the coordinator");
        self.afar = Some((proxy, worker));
    }

    pub fn link(&self) -> Link {
        self.farm.link()
    }

    /// Usage of the coordinator.
    pub fn usage(&self) -> Option<Usage> {
        self.farm.coordinator().usage()
    }

    /// Peak memory of coordinator and workers together, if they have a control group.
    pub fn peak_bytes(&self) -> Option<u64> {
        self.farm.memory().map(MemoryGroup::peak_bytes)
    }

    pub fn database(&self) -> PathBuf {
        self.farm.database()
    }

    /// # Panics
    /// If a process has ended by itself.
    pub fn assert_all_run(&mut self) {
        assert!(self.farm.coordinator_runs(), "the coordinator ended by itself");
        let afar = self.afar.iter_mut().map(|(_, worker)| worker);
        assert!(self.workers.iter_mut().chain(afar).all(Process::is_running), "a worker ended by itself");
    }

    /// # Panics
    /// If a process does not handle it as expected.
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
                assert_eq!(self.workers[victim].terminate(END), 0, "SIGTERM to a worker");
                self.workers[victim] = worker(&self.farm, victim);
            }
            Fault::HangUpWorker => {
                self.workers[victim].hang_up();
                assert_eq!(self.workers[victim].exit_within(END), 0, "SIGHUP to a worker");
                self.workers[victim] = worker(&self.farm, victim);
            }
            Fault::FreezeLink => self.afar.iter().for_each(|(proxy, _)| proxy.freeze()),
            Fault::HalfOpen => self.send_partial_greeting(chance),
            Fault::Garbage => self.send_garbage(chance),
        }
    }

    fn send_partial_greeting(&mut self, chance: &mut Normal) {
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

    /// Stops all processes.
    ///
    /// # Panics
    /// If one of them does not end, or ends with an error.
    pub fn stop(&mut self) {
        // It may be waiting for a dead connection.
        if let Some((_, mut worker)) = self.afar.take() {
            worker.kill();
        }
        for mut worker in self.workers.drain(..) {
            assert_eq!(worker.terminate(END), 0, "SIGTERM to a worker");
        }
        assert_eq!(self.farm.stop_coordinator(), 0, "SIGTERM to the coordinator");
    }
}

fn worker(farm: &Farm, number: usize) -> Process {
    let name = format!("machine-{number}");
    farm.worker_with(&format!("keys/{name}.toml"), &name, &["--grace", "2s"])
}

fn pause_for(process: &Process, pause: Duration) {
    process.signal(Signal::STOP);
    std::thread::sleep(pause);
    process.signal(Signal::CONT);
}
