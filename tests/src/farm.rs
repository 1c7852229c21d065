//! Runs a farm of real processes: a coordinator that keeps its port over restarts, workers, and clients.

mod ending;
mod figures;
mod hardships;
mod tokens;

use std::io::pipe;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use anyhow::{Context, Result, ensure};
use farm_link::{ClientAccess, Link, Target};
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_proto::wire::fits_client::FitsClient;
use farm_proto::wire::{SubmitRequest, WatchRequest};
use optics_model::Grid;
use serde_json::Value;
use tonic::transport::{Channel, Endpoint};

use crate::process::{LONG, Process, Ran, SOON, Surroundings, farmctl, free_port, run, wait_for};
use crate::test_worker::TestWorker;
use crate::wall_clock::WallClock;

/// A coordinator with a folder for its data, its access files and all logs.
#[derive(Debug)]
pub struct Farm {
    coordinator: Option<Process>,
    folder: tempfile::TempDir,
    data: PathBuf,
    port: u16,
    metrics: u16,
    /// Whether calls need an access file of `keys`.
    closed: bool,
    options: Vec<String>,
    /// Environment of the coordinator and the workers.
    surroundings: Surroundings,
    /// Whether the reader of the coordinator's log has closed its pipe.
    log_abandoned: bool,
    logs: AtomicU32,
}

impl Farm {
    /// Starts a coordinator without access files, and waits until it answers.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn start(options: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let data = folder.path().join("data");
        Self::with_data(folder, data, options)
    }

    /// Starts a farm with a simulated wall clock, also for the workers.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn by_wall_clock(clock: WallClock, options: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let data = folder.path().join("data");
        let mut farm = Self::new(folder, data, options);
        farm.surroundings.wall_clock = Some(clock);
        farm.started()
    }

    /// Sets the error of the simulated wall clock.
    ///
    /// # Panics
    /// If the farm has no simulated clock.
    pub fn set_clock_off_by_days(&self, days: i32) {
        let clock = self.surroundings.wall_clock.as_ref();
        clock.expect("the farm has a simulated wall clock").set_off_by_days(days);
    }

    /// Starts a coordinator without access files on the data of an existing folder.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn with_data(folder: tempfile::TempDir, data: PathBuf, options: &[&str]) -> Self {
        Self::new(folder, data, options).started()
    }

    /// Makes access files in `keys` with these options of `farmctl access create`, and starts a coordinator that
    /// requires them.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn closed(access: &[&str], options: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let data = folder.path().join("data");
        let mut farm = Self::new(folder, data, options);
        farm.create_access("keys", access);
        farm.closed = true;
        farm.started()
    }

    fn new(folder: tempfile::TempDir, data: PathBuf, options: &[&str]) -> Self {
        Self {
            coordinator: None,
            folder,
            data,
            port: free_port(),
            metrics: free_port(),
            closed: false,
            options: options.iter().map(ToString::to_string).collect(),
            surroundings: Surroundings::default(),
            log_abandoned: false,
            logs: AtomicU32::new(0),
        }
    }

    fn started(mut self) -> Self {
        self.start_coordinator();
        self
    }

    /// Makes a set of access files for this farm's address.
    ///
    /// # Panics
    /// If they cannot be made.
    pub fn create_access(&self, set: &str, options: &[&str]) {
        let port = self.port.to_string();
        let args = ["access", "create", set, "--host", "localhost", "--port", &port];
        let created = run(self.folder(), &[&args[..], options].concat());
        assert_eq!(created.code, 0, "{}", created.stderr);
    }

    /// Starts the coordinator again with the same port and data, and waits until it answers.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn start_coordinator(&mut self) {
        let (listen, metrics) = (format!("127.0.0.1:{}", self.port), format!("127.0.0.1:{}", self.metrics));
        let (data, access) = (text(&self.data), self.path("keys/coordinator.toml"));
        let mut args = vec!["--listen", &listen, "--metrics", &metrics, "--data", data];
        if self.closed {
            args.extend(["--access", text(&access)]);
        }
        args.extend(self.options.iter().map(String::as_str));
        let mut command = self.surroundings.command("farm-coordinator", &args);
        let mut process = if self.log_abandoned {
            let (_, log) = pipe().expect("there can be another pipe");
            Process::logging_to("farm-coordinator", &mut command, log)
        } else {
            Process::spawn("farm-coordinator", &mut command, &self.path("coordinator.log"))
        };
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

    /// Whether the coordinator's process is still running.
    pub fn coordinator_runs(&mut self) -> bool {
        self.coordinator.as_mut().is_some_and(Process::is_running)
    }

    /// Stops the coordinator and starts it on other data.
    ///
    /// # Panics
    /// If it ends with an error or does not answer.
    pub fn move_to(&mut self, data: &str) {
        assert_eq!(self.stop_coordinator(), 0);
        self.data = self.path(data);
        self.start_coordinator();
    }

    /// Starts a replacement on another machine's data with the same address, after the loss of this one.
    ///
    /// # Panics
    /// If it does not answer.
    pub fn stand_in(&mut self, data: &str) {
        self.data = self.path(data);
        self.start_coordinator();
    }

    pub fn url(&self) -> String {
        let scheme = if self.closed { "https" } else { "http" };
        format!("{scheme}://127.0.0.1:{}", self.port)
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// A file or folder of the farm's folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder().join(name)
    }

    pub fn database(&self) -> PathBuf {
        self.data.join("farm.db")
    }

    /// A worker with one thread, called `label`, at this farm.
    pub fn worker(&self, label: &str, options: &[&str]) -> Process {
        if self.closed {
            return self.worker_with("keys/worker.toml", label, options);
        }
        self.worker_at(&self.url(), label, options)
    }

    /// A worker that reaches the farm at another address.
    pub fn worker_at(&self, url: &str, label: &str, options: &[&str]) -> Process {
        self.start_worker(["--server", url], label, options)
    }

    /// A worker with an access file of the farm's folder.
    pub fn worker_with(&self, access: &str, label: &str, options: &[&str]) -> Process {
        self.start_worker(["--access", text(&self.path(access))], label, options)
    }

    fn start_worker(&self, way: [&str; 2], label: &str, options: &[&str]) -> Process {
        let number = self.logs.fetch_add(1, Ordering::Relaxed);
        let log = self.path(&format!("{label}-{number}.log"));
        let args = ["--threads", "1", "--label", label, "--log-format", "json"];
        let args = [&way[..], &args, options].concat();
        Process::spawn("farm-worker", &mut self.surroundings.command("farm-worker", &args), &log)
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

    /// `farmctl` with this farm; as admin if it has access files.
    pub fn farmctl(&self, args: &[&str]) -> Ran {
        if self.closed {
            self.farmctl_with("keys/admin.toml", args)
        } else {
            self.command(args).output().unwrap().into()
        }
    }

    /// `farmctl` with an access file.
    pub fn farmctl_with(&self, access: &str, args: &[&str]) -> Ran {
        run(self.folder(), &[args, &["--access", access]].concat())
    }

    /// A `farmctl` command for this open farm, not yet started.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = farmctl(self.folder());
        command.args(args).args(["--server", &self.url()]);
        command
    }

    /// The data that `farmctl --json` prints; the command must succeed.
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

    /// The output of `farmctl show` for a dictionary.
    pub fn show(&self, name: &str) -> Value {
        self.ask(&["show", name])
    }

    /// The dictionary's entry of `farmctl list`; None if the coordinator does not answer.
    pub fn listed(&self, name: &str) -> Option<Value> {
        let ran = self.farmctl(&["list", "--json"]);
        let answer: Value = serde_json::from_str(&ran.stdout).ok()?;
        answer["data"]["dictionaries"].as_array()?.iter().find(|d| d["name"] == name).cloned()
    }

    /// Waits until the dictionary is done, and returns the digest of its records.
    ///
    /// # Panics
    /// If it is not done in time.
    pub fn done(&self, name: &str) -> String {
        wait_for(&format!("{name} is done"), LONG, || {
            let listed = self.listed(name)?;
            let digest = listed["records_digest"].as_str()?.to_owned();
            (listed["state"] == "done").then_some(digest)
        })
    }

    /// Waits until workers hold at least `least` leases of the dictionary.
    ///
    /// # Panics
    /// If they do not in time.
    pub fn leased(&self, name: &str, least: u64) {
        wait_for("jobs are leased", SOON, || {
            (self.listed(name)?["jobs_leased"].as_u64()? >= least).then_some(())
        });
    }

    /// Past events of a kind.
    pub fn events(&self, kind: &str) -> Vec<Value> {
        let events = self.ask(&["events", "-n", "1000"])["events"].take();
        events.as_array().unwrap().iter().filter(|e| e["kind"] == kind).cloned().collect()
    }

    /// A lazy connection to the farm; as admin if it has access files.
    ///
    /// # Panics
    /// If the access file cannot be read.
    pub fn link(&self) -> Link {
        if self.closed {
            return self.link_with("keys/admin.toml");
        }
        Target::new(None, Some(&self.url())).unwrap().connect_lazy()
    }

    /// A link with an access file of the farm's folder.
    ///
    /// # Panics
    /// If it cannot be read.
    pub fn link_with(&self, access: &str) -> Link {
        let access = ClientAccess::read(&self.path(access)).unwrap();
        Target::new(Some(&access), None).unwrap().connect_lazy()
    }

    /// A connection to the port of this open farm.
    ///
    /// # Panics
    /// If it cannot be made.
    pub async fn channel(&self) -> Channel {
        Endpoint::from_shared(self.url()).unwrap().connect().await.unwrap()
    }

    pub fn dictionaries(&self) -> DictionariesClient<Link> {
        DictionariesClient::new(self.link()).max_decoding_message_size(16 << 20)
    }

    pub fn fits(&self) -> FitsClient<Link> {
        FitsClient::new(self.link())
    }

    /// A worker that a test controls.
    pub async fn test_worker(&self, label: &str) -> Result<TestWorker, tonic::Status> {
        TestWorker::register(self.link(), label).await
    }

    /// Submits a grid under a name, by a direct call.
    pub async fn submit_grid(&self, name: &str, grid: &Grid) -> Result<DictionaryStatus> {
        let request = SubmitRequest { name: name.to_owned(), grid: Some(grid.into()), priority: 0 };
        Ok(self.dictionaries().submit(request).await?.into_inner().try_into()?)
    }

    /// Watches a dictionary until it is done.
    pub async fn watched(&self, name: &str) -> Result<DictionaryStatus> {
        let request = WatchRequest { name: name.to_owned() };
        let mut updates = self.dictionaries().watch(request).await?.into_inner();
        let mut last = None;
        while let Some(update) = updates.message().await? {
            last = Some(DictionaryStatus::try_from(update)?);
        }
        let status = last.context("the watch returned no status")?;
        ensure!(status.state() == DictionaryState::Done, "{:?}", status.failed);
        Ok(status)
    }

    /// Executes a statement in the coordinator's database.
    ///
    /// # Panics
    /// If it fails.
    pub async fn execute(&self, statement: &'static str) {
        use sqlx::Connection;
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(self.database());
        let mut database = sqlx::SqliteConnection::connect_with(&options).await.expect("it can be opened");
        sqlx::query(statement).execute(&mut database).await.expect("it can be executed");
    }

    /// Number of rows of records in the database, and of those that duplicate another's point and albedo.
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

fn text(path: &Path) -> &str {
    path.to_str().expect("the path is text")
}
