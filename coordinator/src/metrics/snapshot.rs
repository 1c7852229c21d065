//! Exposes the state at the moment of a scrape: states, progress, sizes.

use std::fmt;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeGaugeValue, EncodeMetric};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;

use super::process::Process;

/// Largest number of dictionaries in `farm_work_done_ratio`; further ones are left out.
pub const MOST_RATIOS: usize = 100;

/// The coordinator's state at a scrape; the caller ensures that it is quick to create.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Snapshot {
    pub jobs: JobCounts,
    pub workers: WorkerCounts,
    pub dictionaries: DictionaryCounts,
    /// Name and share of the work that is done, 0 to 1; the first [`MOST_RATIOS`] are exposed.
    pub work_done: Vec<(String, f64)>,
    /// Size of the database with its log.
    pub database_bytes: u64,
    /// Age of the last backup since the start; None without one.
    pub backup_age_s: Option<f64>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JobCounts {
    pub pending: u64,
    pub leased: u64,
    pub done: u64,
    pub failed: u64,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WorkerCounts {
    pub working: u64,
    pub idle: u64,
    pub draining: u64,
    pub silent: u64,
    pub suspended: u64,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DictionaryCounts {
    pub running: u64,
    pub paused: u64,
    pub done: u64,
    pub failed: u64,
    pub cancelled: u64,
}

/// The metrics of one answer.
#[derive(Debug)]
pub(super) struct Scrape {
    snapshot: Snapshot,
    process: Process,
}

impl Scrape {
    pub(super) fn new(snapshot: Snapshot) -> Self {
        Self { snapshot, process: Process::now() }
    }
}

impl Collector for Scrape {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        states(&mut encoder, &self.snapshot)?;
        let done =
            self.snapshot.work_done.iter().take(MOST_RATIOS).map(|(name, ratio)| (name.as_str(), *ratio));
        labelled(
            &mut encoder,
            ("farm_work_done_ratio", "Share of a dictionary's work that is done, from 0 to 1."),
            "dictionary",
            done,
        )?;
        let bytes = self.snapshot.database_bytes;
        gauge(&mut encoder, "farm_database_bytes", "Size of the database with its log.", &bytes)?;
        if let Some(age) = self.snapshot.backup_age_s {
            gauge(&mut encoder, "farm_backup_age_seconds", "Age of the last backup since the start.", &age)?;
        }
        process(&mut encoder, &self.process)
    }
}

fn states(encoder: &mut DescriptorEncoder<'_>, snapshot: &Snapshot) -> fmt::Result {
    let JobCounts { pending, leased, done, failed } = snapshot.jobs;
    let jobs = [("pending", pending), ("leased", leased), ("done", done), ("failed", failed)];
    labelled(encoder, ("farm_jobs", "Jobs of all dictionaries by state."), "state", jobs)?;
    let WorkerCounts { working, idle, draining, silent, suspended } = snapshot.workers;
    let workers = [
        ("working", working),
        ("idle", idle),
        ("draining", draining),
        ("silent", silent),
        ("suspended", suspended),
    ];
    labelled(encoder, ("farm_workers", "Registered workers by state."), "state", workers)?;
    let DictionaryCounts { running, paused, done, failed, cancelled } = snapshot.dictionaries;
    let dictionaries = [
        ("running", running),
        ("paused", paused),
        ("done", done),
        ("failed", failed),
        ("cancelled", cancelled),
    ];
    labelled(encoder, ("farm_dictionaries", "Dictionaries by state."), "state", dictionaries)
}

fn process(encoder: &mut DescriptorEncoder<'_>, process: &Process) -> fmt::Result {
    if let Some(bytes) = process.resident_memory_bytes {
        gauge(encoder, "process_resident_memory_bytes", "Memory of this process that is in RAM.", &bytes)?;
    }
    if let Some(files) = process.open_fds {
        gauge(encoder, "process_open_fds", "File descriptors that this process has open.", &files)?;
    }
    let help = "Processor time that this process has used.";
    let metric = encoder.encode_descriptor("process_cpu_seconds", help, None, MetricType::Counter)?;
    ConstCounter::new(process.cpu_seconds).encode(metric)
}

fn gauge(
    encoder: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    value: &impl EncodeGaugeValue,
) -> fmt::Result {
    encoder.encode_descriptor(name, help, None, MetricType::Gauge)?.encode_gauge(value)
}

fn labelled<'a, V: EncodeGaugeValue>(
    encoder: &mut DescriptorEncoder<'_>,
    (name, help): (&str, &str),
    label: &'static str,
    rows: impl IntoIterator<Item = (&'a str, V)>,
) -> fmt::Result {
    let mut metric = encoder.encode_descriptor(name, help, None, MetricType::Gauge)?;
    for (value, figure) in rows {
        metric.encode_family(&[(label, value)])?.encode_gauge(&figure)?;
    }
    Ok(())
}
