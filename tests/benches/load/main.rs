//! Measures the load on a coordinator in a separate process, from simulated workers that trace nothing.
//!
//! `cargo bench -p farm-tests --bench load` lets 1,000 workers on 32 connections do 100,000 jobs of one small record
//! each as fast as possible. `… --bench load -- paper` lets 64 workers, each on a connection of its own, send the
//! results of the paper's grid, one job per 130 ms, as 64 cores would; `… -- two-cores` does the same with two.
//! Settings: `FARM_LOAD_WORKERS`, `FARM_LOAD_JOBS`, and `FARM_LOAD_FOLDER`, the folder on whose disk the database lies
//! (by default that of the build).
//!
//! The program prints processor time, memory and open files of the coordinator, the latencies of calls, and how many
//! jobs were committed together. Client and coordinator share the machine, so the rate of jobs is a lower bound.

#![expect(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "a benchmark may panic, and measures real time"
)]

mod crew;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use farm_proto::wire::SubmitRequest;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_tests::process::{Process, free_port, program};
use farm_tests::usage::Usage;
use optics_model::grid::Axes;
use optics_model::scene::{Channel, Scene, Sensor};
use optics_model::{Grid, Walks};
use tonic::transport::{Channel as Link, Endpoint};

use crew::{Crew, Latencies};

/// The load on the coordinator.
struct Load {
    workers: usize,
    connections: usize,
    grids: Vec<Grid>,
    /// Leases per Acquire.
    at_once: u32,
    /// Time per job; if it is 0, the results of one Acquire are delivered together.
    job: Duration,
}

fn setting(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |v| v.parse().unwrap())
}

/// `from`, then steps that are exact in binary.
fn steps(from: f64, step: f64, count: usize) -> Vec<f64> {
    (0..count).map(|i| from + step * i as f64).collect()
}

fn small() -> Load {
    let jobs = setting("FARM_LOAD_JOBS", 100_000);
    let axes = Axes {
        sigma_t_per_mm: steps(1.0, 1.0 / 64.0, jobs.div_ceil(250)),
        albedo: vec![0.9],
        g: steps(-0.5, 1.0 / 256.0, 250.min(jobs)),
        thickness_mm: vec![1.0],
        sample_ior: vec![1.53],
    };
    let scene = Scene::paper().with_channels(vec![Channel::new("R", 0.985, 0.024).unwrap()]).unwrap();
    let scene = scene.with_sensor(Sensor::new(10.0, 8, 0.0).unwrap());
    let grid = Grid::new(scene, axes, Walks::new(5000).unwrap(), 1, false).unwrap();
    let workers = setting("FARM_LOAD_WORKERS", 1000);
    Load { workers, connections: workers.min(32), grids: vec![grid], at_once: 16, job: Duration::ZERO }
}

/// The paper's grid with several seeds.
fn paper(workers: usize, jobs: usize) -> Load {
    let (paper, workers) = (Grid::paper(), setting("FARM_LOAD_WORKERS", workers));
    let count = setting("FARM_LOAD_JOBS", jobs).div_ceil(paper.job_count()) as u64;
    let seeded = |seed| {
        let axes = Axes {
            sigma_t_per_mm: paper.sigma_t_per_mm().to_vec(),
            albedo: paper.albedo().to_vec(),
            g: paper.g().to_vec(),
            thickness_mm: paper.thickness_mm().to_vec(),
            sample_ior: paper.sample_ior().to_vec(),
        };
        Grid::new(Scene::paper(), axes, Walks::PAPER, seed, false).unwrap()
    };
    let grids = (1..=count).map(seeded).collect();
    Load { workers, connections: workers, grids, at_once: 2, job: Duration::from_millis(130) }
}

#[tokio::main(flavor = "current_thread")]
async fn main() {
    let mode = std::env::args().skip(1).find(|arg| !arg.starts_with('-')).unwrap_or_default();
    let load = match mode.as_str() {
        "" | "small" => small(),
        "paper" => paper(64, 6688),
        "two-cores" => paper(2, 300),
        other => panic!("unknown load {other:?}: use small, paper or two-cores"),
    };
    run(load).await;
}

async fn run(load: Load) {
    let folder = std::env::var_os("FARM_LOAD_FOLDER")
        .map_or_else(|| PathBuf::from(env!("CARGO_TARGET_TMPDIR")), PathBuf::from);
    let data = tempfile::tempdir_in(&folder).unwrap();
    let (port, metrics) = (free_address(), free_address());
    let mut command = Command::new(program("farm-coordinator"));
    command.env_clear().env("FARM_LOG", "warn");
    command
        .args(["--insecure", "--listen", &port.to_string(), "--metrics", &metrics.to_string(), "--data"])
        .arg(data.path());
    let process = Process::spawn("farm-coordinator", &mut command, &data.path().join("coordinator.log"));
    let pid = process.id();
    let links = links(port, load.connections).await;
    let start = Instant::now();
    submit(&links[0], &load.grids).await;
    println!("submitted in {:.2?}", start.elapsed());
    print_usage("with the grid", pid);
    let jobs: usize = load.grids.iter().map(Grid::job_count).sum();
    let crew = Arc::new(Crew::new(jobs, load.at_once, load.job, &load.grids[0]));
    let start = Instant::now();
    let workers = crew.register(&links, load.workers).await;
    println!("{} workers registered in {:.2?}", load.workers, start.elapsed());
    let (before, own) = (print_usage("with the workers", pid), own_usage());
    let start = Instant::now();
    let marks = tokio::spawn(print_marks(crew.clone(), pid));
    let latencies = crew.work(workers).await;
    let wall = start.elapsed();
    marks.await.unwrap();
    print_rate(jobs, wall, before, Usage::of(pid).unwrap(), own_usage().cpu_s - own.cpu_s);
    print_latencies(latencies);
    print_commits(metrics);
    let bytes = |name: &str| std::fs::metadata(data.path().join(name)).map_or(0, |m| m.len()) >> 20;
    println!("database {} MiB, log {} MiB", bytes("farm.db"), bytes("farm.db-wal"));
}

/// A loopback port that is free now.
fn free_address() -> SocketAddr {
    ([127, 0, 0, 1], free_port()).into()
}

async fn links(address: SocketAddr, count: usize) -> Vec<Link> {
    let endpoint = Endpoint::from_shared(format!("http://{address}")).unwrap();
    let mut links = Vec::with_capacity(count);
    let start = Instant::now();
    while links.len() < count {
        match endpoint.connect().await {
            Ok(link) => links.push(link),
            Err(error) => {
                assert!(
                    start.elapsed() < Duration::from_secs(30),
                    "the coordinator does not answer: {error}"
                );
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
    links
}

async fn submit(link: &Link, grids: &[Grid]) {
    let mut client = DictionariesClient::new(link.clone()).max_decoding_message_size(64 << 20);
    for (number, grid) in grids.iter().enumerate() {
        let request = SubmitRequest { name: format!("load-{number}"), grid: Some(grid.into()), priority: 0 };
        client.submit(request).await.unwrap();
    }
}

fn own_usage() -> Usage {
    Usage::of(std::process::id()).unwrap()
}

fn print_usage(when: &str, pid: u32) -> Usage {
    let usage = Usage::of(pid).unwrap();
    println!("{when}: {} MiB resident, {} files", usage.resident_kib >> 10, usage.files);
    usage
}

async fn print_marks(crew: Arc<Crew>, pid: u32) {
    for percent in [10, 50, 100] {
        while crew.stored_percent() < percent {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        print_usage(&format!("at {percent} %"), pid);
    }
}

fn print_rate(jobs: usize, wall: Duration, before: Usage, after: Usage, own_cpu_s: f64) {
    let (cpu_s, wall_s) = (after.cpu_s - before.cpu_s, wall.as_secs_f64());
    println!("{jobs} jobs in {wall_s:.2} s: {:.0} jobs per second", jobs as f64 / wall_s);
    println!(
        "coordinator: {cpu_s:.2} s of processor time, {:.3} ms per job, {:.1} % of a core",
        1e3 * cpu_s / jobs as f64,
        100.0 * cpu_s / wall_s
    );
    println!(
        "this client: {own_cpu_s:.2} s of processor time, {:.1} % of a core",
        100.0 * own_cpu_s / wall_s
    );
}

fn print_latencies(latencies: Latencies) {
    let Latencies { acquire, complete } = latencies;
    for (call, mut times) in [("Acquire", acquire), ("Complete", complete)] {
        times.sort_unstable();
        let quantile = |q: f64| times[((times.len() - 1) as f64 * q) as usize];
        println!("{call}: {} calls, median {:.1?}, p99 {:.1?}", times.len(), quantile(0.5), quantile(0.99));
    }
}

fn print_commits(metrics: SocketAddr) {
    let mut stream = TcpStream::connect(metrics).unwrap();
    write!(stream, "GET /metrics HTTP/1.1\r\nhost: farm\r\nconnection: close\r\n\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let value = |name: &str| -> f64 {
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        line.unwrap_or_else(|| panic!("no {name} in {text}")).trim().parse().unwrap()
    };
    let (commits, jobs) = (value("farm_commit_jobs_count"), value("farm_commit_jobs_sum"));
    println!(
        "{commits} commits, {:.1} jobs and {:.1} ms each",
        jobs / commits,
        1e3 * value("farm_commit_seconds_sum") / commits
    );
}
