//! Measures the speed of the tracer and its parts, for every kernel that this machine can run, on one thread.
//!
//! `cargo bench -p optics-tracer` runs all benchmarks, `cargo bench -p optics-tracer -- points/avx2` the matching ones.

#![expect(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::hint::black_box;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use optics_model::grid::Grid;
use optics_model::job::JobSpec;
use optics_model::scene::{Layer, Scene};
use optics_model::{TransportPoint, Walks};
use optics_tracer::probe::{Scoring, count_events, run_walks};
use optics_tracer::{Kernel, trace_with};

/// Walks of a measurement: one chunk.
const WALKS: u64 = 25_000;

fn job(scene: Scene, [sigma_t, g, thickness]: [f64; 3], albedo: &[f64]) -> JobSpec {
    let point = TransportPoint::new(sigma_t, g, thickness, 1.53).unwrap();
    JobSpec::new(scene, point, albedo.to_vec(), Walks::new(WALKS).unwrap(), 1, false).unwrap()
}

fn single_threaded() -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap()
}

fn group<'a>(c: &'a mut Criterion, name: &str) -> BenchmarkGroup<'a, WallTime> {
    let mut group = c.benchmark_group(name);
    group.sample_size(10).warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    group
}

/// Scatterings per second in a slab so thick that hardly anything else happens.
fn scattering_steps(c: &mut Criterion) {
    let layers = vec![Layer::sample("sample", 0.0).unwrap()];
    let paper = Scene::paper();
    let channels = paper.channels().to_vec();
    let scene = Scene::new(layers, channels, paper.light(), paper.sensor(), false).unwrap();
    let job = job(scene, [200.0, 0.4, 1.0], &[1.0]);
    let mut group = group(c, "scattering steps");
    group.throughput(Throughput::Elements(count_events(&job).scatterings));
    for kernel in Kernel::all() {
        group.bench_function(kernel.name(), |b| b.iter(|| run_walks(kernel, &job)));
    }
}

/// Crossings per second in the paper's stack with a sample that is nearly clear, where rough faces lose light and where they
/// do not.
fn crossings(c: &mut Criterion) {
    let mut group = group(c, "crossings");
    for (name, conserving) in [("lossy", false), ("conserving", true)] {
        let scene = Scene::paper().with_multiple_scattering(conserving);
        let job = job(scene, [0.01, 0.0, 0.5], &[1.0]);
        group.throughput(Throughput::Elements(count_events(&job).crossings));
        for kernel in Kernel::all() {
            let id = BenchmarkId::new(kernel.name(), name);
            group.bench_function(id, |b| b.iter(|| run_walks(kernel, &job)));
        }
    }
}

/// Scoring the walks of a chunk for 41 albedos, 3 channels and 360 pixels; walks per second.
fn scoring(c: &mut Criterion) {
    let grid = Grid::paper();
    let job = job(Scene::paper(), [1.0, 0.0, 0.5], grid.albedo());
    let mut group = group(c, "scoring");
    group.throughput(Throughput::Elements(WALKS));
    for kernel in Kernel::all() {
        let mut scoring = Scoring::new(kernel, &job).unwrap();
        group.bench_function(kernel.name(), |b| b.iter(|| black_box(scoring.score())));
    }
}

/// Whole transport points at four corners of the paper's grid, 41 records each; scatterings per second, with
/// everything else that a walk needs.
fn points(c: &mut Criterion) {
    let grid = Grid::paper();
    let pool = single_threaded();
    let mut group = group(c, "points");
    for kernel in Kernel::all() {
        for corner in [[1.0, 0.0, 0.5], [1.0, 0.8, 1.0], [20.0, 0.0, 1.0], [20.0, 0.8, 0.5]] {
            let job = job(Scene::paper(), corner, grid.albedo());
            group.throughput(Throughput::Elements(count_events(&job).scatterings));
            let [sigma_t, g, thickness] = corner;
            let id = BenchmarkId::new(kernel.name(), format!("{sigma_t} per mm, g {g}, {thickness} mm"));
            group.bench_function(id, |b| {
                b.iter(|| pool.install(|| trace_with(kernel, &job, &AtomicBool::new(false)).unwrap()));
            });
        }
    }
}

/// Every seventh transport point of the paper's grid: scatterings per second and core, averaged over the grid, with
/// crossings and scoring.
fn grid(c: &mut Criterion) {
    let grid = Grid::paper();
    let pool = single_threaded();
    let jobs: Vec<_> = (0..grid.job_count())
        .step_by(7)
        .map(|job| {
            let walks = Walks::new(WALKS).unwrap();
            JobSpec::new(grid.scene().clone(), grid.point(job), grid.albedo().to_vec(), walks, 1, false)
                .unwrap()
        })
        .collect();
    let scatterings = jobs.iter().map(|job| count_events(job).scatterings).sum();
    let mut group = group(c, "grid");
    group.throughput(Throughput::Elements(scatterings));
    for kernel in Kernel::all() {
        // Slow kernels would take minutes here.
        if !matches!(kernel.name(), "sse2" | "scalar") {
            group.bench_function(kernel.name(), |b| {
                b.iter(|| {
                    for job in &jobs {
                        pool.install(|| trace_with(kernel, job, &AtomicBool::new(false)).unwrap());
                    }
                });
            });
        }
    }
}

criterion_group!(benches, scattering_steps, crossings, scoring, points, grid);
criterion_main!(benches);
