//! A farm of real processes: a coordinator that keeps its port and its data over restarts, workers, `farmctl`.

use std::fs::File;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU16, AtomicU32, Ordering};
use std::time::Duration;

use optics_model::{Digest, Grid};
use rayon::prelude::*;
pub use rustix::process::Signal;
use serde_json::Value;
use tokio::time::Instant;

use crate::hand::{HandWorker, traced};
use crate::process::{Ran, farmctl, program};

/// How long anything may take that needs no tracing.
pub const SOON: Duration = Duration::from_secs(30);
/// How long a dictionary may take.
pub const LONG: Duration = Duration::from_mins(3);
/// Pause before another look.
const LOOK: Duration = Duration::from_millis(20);

/// Looks until there is something to see, and fails after `limit`.
///
/// # Panics
/// If there is nothing in time.
pub fn wait_for<T>(what: &str, limit: Duration, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + limit;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "waited {limit:?} in vain: {what}");
        std::thread::sleep(LOOK);
    }
}

/// A port that nobody listens on, below those that the system gives to outgoing connections: one of these could take it
/// while its owner restarts.
///
/// # Panics
/// If there is none.
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

/// A program that runs. Killed when dropped; if the test has failed, what it logged is shown.
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
        let mut command = Command::new(program(name));
        for variable in ["FARM_SERVER", "FARM_ACCESS", "FARM_DATA", "FARM_LISTEN", "FARM_METRICS"] {
            command.env_remove(variable);
        }
        // Acknowledged results are told at this level.
        command.env("FARM_LOG", "info,farm_worker=debug").args(args);
        let file = File::options().create(true).append(true).open(log).expect("the log can be written to");
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(file).spawn();
        Self { name: name.to_owned(), child: child.expect("the program starts"), log: log.to_owned() }
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

    /// `kill -9`, and waits until it is gone.
    pub fn kill(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Waits for the end and tells the exit code; -1 after a signal.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn exit_within(&mut self, limit: Duration) -> i32 {
        let status = wait_for(&format!("{} ends", self.name), limit, || {
            self.child.try_wait().expect("it can be waited for")
        });
        status.code().unwrap_or(-1)
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("it can be waited for").is_none()
    }

    /// Standard error so far.
    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Resident memory now, in KiB.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn resident_kib(&self) -> u64 {
        self.memory_kib("VmRSS:")
    }

    /// The most resident memory so far, in KiB.
    ///
    /// # Panics
    /// If the process is gone.
    pub fn peak_kib(&self) -> u64 {
        self.memory_kib("VmHWM:")
    }

    fn memory_kib(&self, field: &str) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.id())).expect("it runs");
        let line = status.lines().find_map(|l| l.strip_prefix(field)).expect("Linux tells the memory");
        line.trim().trim_end_matches("kB").trim().parse().expect("a number of kB")
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

/// A coordinator with data of its own, and who talks to it.
#[derive(Debug)]
pub struct FarmProcesses {
    coordinator: Option<Process>,
    folder: tempfile::TempDir,
    data: PathBuf,
    port: u16,
    metrics: u16,
    options: Vec<String>,
    logs: AtomicU32,
}

impl FarmProcesses {
    /// Starts a coordinator and waits until it answers.
    ///
    /// # Panics
    /// If it does not.
    pub fn start(options: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let data = folder.path().join("data");
        Self::with_data(folder, data, options)
    }

    /// The same with its data in a folder that is there.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn with_data(folder: tempfile::TempDir, data: PathBuf, options: &[&str]) -> Self {
        let options = options.iter().map(ToString::to_string).collect();
        let (port, metrics, logs) = (free_port(), free_port(), AtomicU32::new(0));
        let mut farm = Self { coordinator: None, folder, data, port, metrics, options, logs };
        farm.start_coordinator();
        farm
    }

    /// Starts the coordinator on the port and the data that it had, and waits until it answers.
    ///
    /// # Panics
    /// If it does not.
    pub fn start_coordinator(&mut self) {
        let (listen, metrics) = (format!("127.0.0.1:{}", self.port), format!("127.0.0.1:{}", self.metrics));
        let data = self.data.to_str().expect("the path is text");
        let mut args = vec!["--listen", &listen, "--metrics", &metrics, "--data", data];
        args.extend(self.options.iter().map(String::as_str));
        let log = self.folder.path().join("coordinator.log");
        let mut process = Process::start("farm-coordinator", &args, &log);
        wait_for("the coordinator answers", SOON, || {
            assert!(process.is_running(), "the coordinator ended: {}", process.log());
            self.page("/livez").filter(|(code, _)| *code == 200)
        });
        self.coordinator = Some(process);
    }

    /// # Panics
    /// If it does not run.
    pub fn coordinator(&self) -> &Process {
        self.coordinator.as_ref().expect("the coordinator runs")
    }

    /// `kill -9`.
    pub fn kill_coordinator(&mut self) {
        self.coordinator.take().expect("the coordinator runs").kill();
    }

    /// SIGTERM; the exit code.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn stop_coordinator(&mut self) -> i32 {
        let mut process = self.coordinator.take().expect("the coordinator runs");
        process.signal(Signal::TERM);
        process.exit_within(Duration::from_secs(10))
    }

    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn database(&self) -> PathBuf {
        self.data.join("farm.db")
    }

    /// A worker with one thread, called `label`, at this farm.
    pub fn worker(&self, label: &str, options: &[&str]) -> Process {
        self.worker_at(&self.url(), label, options)
    }

    /// A worker that reaches the farm at another address.
    pub fn worker_at(&self, url: &str, label: &str, options: &[&str]) -> Process {
        let number = self.logs.fetch_add(1, Ordering::Relaxed);
        let log = self.folder.path().join(format!("{label}-{number}.log"));
        let args = ["--server", url, "--threads", "1", "--label", label, "--log-format", "json"];
        Process::start("farm-worker", &[&args[..], options].concat(), &log)
    }

    /// Logs of all workers so far, as JSON objects.
    pub fn worker_logs(&self) -> Vec<Value> {
        let files = std::fs::read_dir(self.folder.path()).unwrap().map(|entry| entry.unwrap().path());
        let logs =
            files.filter(|f| f.extension().is_some_and(|e| e == "log") && !f.ends_with("coordinator.log"));
        let texts: Vec<String> = logs.map(|f| std::fs::read_to_string(f).unwrap()).collect();
        // A worker that was killed may have left half a line.
        texts.iter().flat_map(|t| t.lines()).filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    /// `farmctl` with this farm.
    pub fn farmctl(&self, args: &[&str]) -> Ran {
        farmctl(self.folder.path()).args(args).args(["--server", &self.url()]).output().unwrap().into()
    }

    /// `farmctl --json`, which must succeed: the data of its answer.
    ///
    /// # Panics
    /// If it fails.
    pub fn ask(&self, args: &[&str]) -> Value {
        let ran = self.farmctl(&[args, &["--json"]].concat());
        assert_eq!(ran.code, 0, "{args:?}: {} {}", ran.stdout, ran.stderr);
        let mut answer: Value = serde_json::from_str(&ran.stdout).expect("--json prints JSON");
        answer["data"].take()
    }

    /// Submits a grid under a name.
    pub fn submit(&self, name: &str, grid: &str) {
        let file = self.folder.path().join(format!("{name}.toml"));
        std::fs::write(&file, grid).unwrap();
        self.ask(&["submit", file.to_str().unwrap()]);
    }

    /// What `farmctl show` tells of a dictionary.
    pub fn show(&self, name: &str) -> Value {
        self.ask(&["show", name])
    }

    /// What `farmctl list` tells; None if the coordinator does not answer.
    pub fn listed(&self, name: &str) -> Option<Value> {
        let ran = self.farmctl(&["list", "--json"]);
        let answer: Value = serde_json::from_str(&ran.stdout).ok()?;
        answer["data"]["dictionaries"].as_array()?.iter().find(|d| d["name"] == name).cloned()
    }

    /// Waits until the dictionary is done: its records' digest.
    ///
    /// # Panics
    /// If it is not in time.
    pub fn done(&self, name: &str) -> String {
        wait_for(&format!("{name} is done"), LONG, || {
            let listed = self.listed(name)?;
            let digest = listed["records_digest"].as_str()?.to_owned();
            (listed["state"] == "done").then_some(digest)
        })
    }

    /// Waits until workers hold at least so many leases of the dictionary.
    ///
    /// # Panics
    /// If they do not in time.
    pub fn leased(&self, name: &str, least: u64) {
        wait_for("jobs are leased", SOON, || {
            (self.listed(name)?["jobs_leased"].as_u64()? >= least).then_some(())
        });
    }

    /// Events of a kind that have happened.
    pub fn events(&self, kind: &str) -> Vec<Value> {
        let events = self.ask(&["events", "-n", "1000"])["events"].take();
        events.as_array().unwrap().iter().filter(|e| e["kind"] == kind).cloned().collect()
    }

    /// A page of the port for figures: status code and text. None if nobody answers.
    pub fn page(&self, path: &str) -> Option<(u16, String)> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.metrics)).ok()?;
        stream.set_read_timeout(Some(SOON)).ok()?;
        write!(stream, "GET {path} HTTP/1.1\r\nHost: farm\r\nConnection: close\r\n\r\n").ok()?;
        let mut text = String::new();
        stream.read_to_string(&mut text).ok()?;
        let code = text.split(' ').nth(1)?.parse().ok()?;
        Some((code, text.split_once("\r\n\r\n")?.1.to_owned()))
    }

    /// A figure since the coordinator's start, as in `farm_jobs_completed_total{outcome="stored"}`.
    ///
    /// # Panics
    /// If the coordinator does not tell it.
    pub fn figure(&self, name: &str) -> u64 {
        let (_, text) = self.page("/metrics").expect("the coordinator tells figures");
        let line = text.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(' '));
        line.map_or(0.0, |value| value.parse::<f64>().expect("a number")) as u64
    }

    /// A worker by hand.
    pub async fn hand(&self, label: &str) -> Result<HandWorker, tonic::Status> {
        let link = tonic::transport::Endpoint::from_shared(self.url()).unwrap().connect_lazy();
        HandWorker::register(link, label).await
    }

    /// Rows of records in the database, and how many of them are not the only one of their point and albedo.
    ///
    /// # Panics
    /// If it cannot be read.
    pub async fn record_rows(&self) -> (u64, u64) {
        use sqlx::{Connection, Row};
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(self.database()).read_only(true);
        let mut database = sqlx::SqliteConnection::connect_with(&options).await.expect("it can be opened");
        let query = "SELECT count(*), count(*) - (SELECT count(*) FROM (SELECT DISTINCT point_id, albedo FROM records)) \
                     FROM records";
        let row = sqlx::query(query).fetch_one(&mut database).await.expect("it can be read");
        (row.get::<i64, _>(0) as u64, row.get::<i64, _>(1) as u64)
    }
}

/// The grid of a file's text.
///
/// # Panics
/// If it is none.
pub fn grid_of(text: &str) -> Grid {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("grid.toml");
    std::fs::write(&file, text).unwrap();
    farmctl::read_grid(&file).unwrap()
}

/// The digest of a grid's records when nothing disturbs.
pub fn undisturbed(text: &str) -> String {
    let grid = grid_of(text);
    let jobs: Vec<Digest> =
        (0..grid.job_count()).into_par_iter().map(|job| Digest::of_records(&traced(&grid, job))).collect();
    Digest::of_jobs(jobs).to_string()
}
