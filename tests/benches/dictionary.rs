//! Times a dictionary from `farmctl submit` to the last record in the database, on all cores.
//!
//! `cargo bench -p farm-tests --bench dictionary` takes the paper's grid with 25,000 walks a point, a tenth of the
//! paper's; with `FARM_BENCH_WALKS=250000` it is the paper's dictionary itself.

#![expect(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use farm_tests::process::run;

fn dictionary(c: &mut Criterion) {
    let walks: u64 = std::env::var("FARM_BENCH_WALKS").map_or(25_000, |v| v.parse().unwrap());
    let mut group = c.benchmark_group("dictionary");
    group.sample_size(10).warm_up_time(Duration::from_millis(1)).measurement_time(Duration::from_secs(1));
    group.throughput(Throughput::Elements(34_276));
    group.bench_function(format!("34,276 records with {walks} walks"), |b| {
        b.iter_with_large_drop(|| {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join("grid.toml"), format!("walks = {walks}\n")).unwrap();
            let ran = run(folder.path(), &["submit", "grid.toml", "--quiet"]);
            assert_eq!(ran.code, 0, "{}", ran.stderr);
            folder
        });
    });
}

criterion_group!(benches, dictionary);
criterion_main!(benches);
