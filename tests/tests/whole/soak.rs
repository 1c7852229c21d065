//! Soak test: a farm under load and random faults. All records stay correct, and memory, files and database do not
//! grow.
//!
//! 20 seconds by default; `FARM_SOAK_MINUTES=60 cargo test --workspace --test whole soak -- --nocapture` takes an hour and
//! prints a curve. `FARM_SOAK_SEED` chooses other faults.
//!
//! In the first quarter the coordinator is killed repeatedly. Then it runs to the end, so that leaks become visible: from
//! when it is warm, between the first and the last third, the medians of its memory and open files must not grow by more
//! than the allocator and open connections explain.

#![expect(clippy::disallowed_methods, reason = "this test works in real time")]

mod client;
mod maltreated;

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use farm_tests::statistics::Normal;
use farm_tests::usage::Usage;
use tokio_util::sync::CancellationToken;

use client::{Client, RECORD_BYTES, RECORDS, Tally};
use maltreated::{Fault, FaultyFarm};

const LEASE_S: u64 = 2;
const WORKERS: usize = 3;
const CLIENTS: u64 = 3;
/// Memory may grow by a tenth and this much: caches of SQLite's five connections, 2 MB each, and freed memory that the
/// allocator keeps in its arenas. A byte and a half lost per byte stored would exceed it within a minute.
const SLACK_KIB: u64 = 16 << 10;
/// Files may grow by this much: silent connections that are not yet closed.
const SLACK_FILES: usize = 8;
/// Dictionaries after which a coordinator is warm: each client has used all of its connections to the database.
const WARM_AFTER: u64 = 2 * CLIENTS;
/// Samples that show a trend, and how much longer a slow machine may take for them.
const FEWEST_SAMPLES: usize = 12;
const PATIENCE: Duration = Duration::from_mins(2);

struct Sample {
    at: Duration,
    usage: Usage,
    database: u64,
    log: u64,
    dictionaries: u64,
}

fn seconds() -> Duration {
    let minutes = std::env::var("FARM_SOAK_MINUTES").ok().map(|v| v.parse::<f64>().unwrap());
    minutes.map_or(Duration::from_secs(20), |minutes| Duration::from_secs_f64(60.0 * minutes))
}

fn seed() -> u64 {
    std::env::var("FARM_SOAK_SEED").map_or(1, |v| v.parse().unwrap())
}

/// A maltreated farm keeps its records, and its memory and files do not grow.
#[test]
fn maltreated_farm_keeps_records_and_size() {
    let whole = seconds();
    let mut farm = FaultyFarm::start(WORKERS, LEASE_S);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    // Connections are made within the runtime.
    let _within = runtime.enter();
    runtime.block_on(farm.add_remote_worker());
    let (start, tally) = (Instant::now(), Arc::new(Tally::default()));
    let stop = CancellationToken::new();
    let clients: Vec<_> = (0..CLIENTS)
        .map(|number| {
            let client = Client::new(farm.link(), number, seed(), tally.clone());
            runtime.spawn(client.run(stop.clone()))
        })
        .collect();
    let samples = maltreat(&mut farm, start, whole, &tally);
    stop.cancel();
    let live: Vec<_> = clients.into_iter().flat_map(|client| runtime.block_on(client).unwrap()).collect();
    let check = Client::new(farm.link(), CLIENTS, seed(), tally.clone());
    let (agreed, disputed) = runtime.block_on(check.checks());
    assert!(agreed > 0 && disputed == 0, "{agreed} checks agreed since the last start, {disputed} did not");
    // Dictionaries that were reported as done are on the disk.
    farm.inflict(Fault::KillCoordinator, &mut Normal::new(0));
    runtime.block_on(check.assert_exactly(&live));
    let events = runtime.block_on(check.last_event());
    farm.assert_all_run();
    farm.stop();
    println!("{tally:?}, {events} events");
    if let Some(peak) = farm.peak_bytes() {
        println!("coordinator and workers had {} MiB at most", peak >> 20);
    }
    print_samples(&samples);
    assert_flat(&samples);
    assert_explained(&farm.database(), live.len(), events, tally.done());
}

/// Inflicts faults, and samples the coordinator when it is warm.
fn maltreat(farm: &mut FaultyFarm, start: Instant, whole: Duration, tally: &Tally) -> Vec<Sample> {
    let (mut samples, mut cold) = (Vec::new(), 0);
    let mut chance = Normal::new(seed());
    // Short runs have shorter pauses.
    let pause = (whole / 40).min(Duration::from_secs(3));
    let (quarter, mut lives) = (whole / 4, false);
    while start.elapsed() < whole || samples.len() < FEWEST_SAMPLES {
        assert!(start.elapsed() < whole + PATIENCE, "{} samples are too few", samples.len());
        std::thread::sleep(pause.mul_f64(0.5 + chance.uniform()));
        farm.assert_all_run();
        let fault = Fault::LIST[(chance.uniform() * Fault::LIST.len() as f64) as usize];
        let dies = if start.elapsed() < quarter {
            chance.uniform() < 0.3
        } else {
            !std::mem::replace(&mut lives, true)
        };
        farm.inflict(if dies { Fault::KillCoordinator } else { fault }, &mut chance);
        let size =
            |name: &str| std::fs::metadata(farm.database().with_file_name(name)).map_or(0, |m| m.len());
        if !lives || dies {
            cold = tally.done();
        } else if tally.done() >= cold + WARM_AFTER
            && let Some(usage) = farm.usage()
        {
            let (database, log) = (size("farm.db"), size("farm.db-wal"));
            samples.push(Sample { at: start.elapsed(), usage, database, log, dictionaries: tally.done() });
        }
    }
    samples
}

fn print_samples(samples: &[Sample]) {
    println!("  time s    memory KiB    files    database KiB    log KiB    dictionaries");
    for sample in samples.iter().step_by(samples.len().div_ceil(25)) {
        let Sample { at, usage, database, log, dictionaries } = sample;
        println!(
            "{:8.0} {:13} {:8} {:15} {:10} {dictionaries:15}",
            at.as_secs_f64(),
            usage.resident_kib,
            usage.files,
            database >> 10,
            log >> 10
        );
    }
}

fn assert_flat(samples: &[Sample]) {
    let third = samples.len() / 3;
    let median = |some: &[Sample], of: fn(&Usage) -> u64| {
        let mut values: Vec<u64> = some.iter().map(|s| of(&s.usage)).collect();
        values.sort_unstable();
        values[values.len() / 2]
    };
    let (first, last) = (&samples[..third], &samples[samples.len() - third..]);
    let memory = |some| median(some, |usage| usage.resident_kib);
    let (before, after) = (memory(first), memory(last));
    println!("memory: median {before} KiB in the first third, {after} KiB in the last");
    assert!(after <= before + before / 10 + SLACK_KIB, "memory grew from {before} to {after} KiB");
    let files = |some| median(some, |usage| usage.files as u64);
    let (before, after) = (files(first), files(last));
    println!("files: median {before} in the first third, {after} in the last");
    assert!(after <= before + SLACK_FILES as u64, "open files grew from {before} to {after}");
}

/// Checks that pages of deleted dictionaries are reused: the file is at most as large as the dictionaries that existed
/// at a time, with the same again for partly filled pages, plus the events and a few pages per table and index.
fn assert_explained(database: &Path, live: usize, events: u64, done: u64) {
    let header = std::fs::read(database).unwrap();
    let number = |at: usize| u64::from(u32::from_be_bytes(header[at..at + 4].try_into().unwrap()));
    let (pages, free, page_bytes) = (number(28), number(36), header.len() as u64 / number(28));
    let dictionary = RECORDS * RECORD_BYTES;
    // In addition to the remaining ones, each client has one in progress.
    let explained = 2 * (live as u64 + CLIENTS) * dictionary + 300 * events + 64 * page_bytes;
    println!(
        "database: {} KiB, of which {} KiB are free; {} KiB of records were stored in all; {} KiB are explained",
        (pages * page_bytes) >> 10,
        (free * page_bytes) >> 10,
        (done * dictionary) >> 10,
        explained >> 10
    );
    assert!(pages * page_bytes <= explained, "the database grew to {pages} pages of {page_bytes} bytes");
}
