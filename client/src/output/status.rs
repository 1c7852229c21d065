//! Formats dictionaries and workers as JSON.

use farm_proto::status::{DictionaryStatus, WorkerStatus};
use serde::Serialize;

/// Progress of a dictionary, as `list`, `submit` and `show` print it.
#[derive(Debug, Serialize)]
pub(crate) struct DictionaryJson {
    name: String,
    state: &'static str,
    records_done: usize,
    records_total: usize,
    jobs_done: usize,
    jobs_leased: usize,
    jobs_disputed: usize,
    jobs_failed: usize,
    jobs_total: usize,
    work_done: f64,
    failed_jobs: Vec<FailedJobJson>,
    created_unix_ms: u64,
    grid_digest: String,
    records_digest: Option<String>,
    records_reused: usize,
    priority: i32,
    eta_s: Option<f64>,
    goes_first: Option<String>,
    reason: String,
    owner: Option<String>,
    walks_min: u64,
    walks_max: u64,
}

#[derive(Debug, Serialize)]
struct FailedJobJson {
    job: u32,
    reason: String,
    quarantined: bool,
}

impl From<&DictionaryStatus> for DictionaryJson {
    fn from(d: &DictionaryStatus) -> Self {
        let failed = d.failed.iter().map(|f| FailedJobJson {
            job: f.job,
            reason: f.reason.clone(),
            quarantined: f.quarantined,
        });
        Self {
            name: d.name.to_string(),
            state: d.state().as_str(),
            records_done: d.records_done(),
            records_total: d.records_total(),
            jobs_done: d.jobs_done,
            jobs_leased: d.jobs_leased,
            jobs_disputed: d.jobs_disputed,
            jobs_failed: d.jobs_failed,
            jobs_total: d.jobs_total(),
            work_done: d.work_done,
            failed_jobs: failed.collect(),
            created_unix_ms: d.created_unix_ms,
            grid_digest: d.grid_digest.to_string(),
            records_digest: d.records_digest.map(|d| d.to_string()),
            records_reused: d.records_reused,
            priority: d.priority,
            eta_s: d.eta_s,
            goes_first: d.goes_first.as_ref().map(ToString::to_string),
            reason: d.reason.clone(),
            owner: (!d.owner.is_empty()).then(|| d.owner.clone()),
            walks_min: d.walks.0,
            walks_max: d.walks.1,
        }
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct WorkerJson {
    worker_id: String,
    label: String,
    threads: u32,
    leases: u32,
    jobs_done: u64,
    silent_ms: u64,
    state: String,
    suspended_ms: u64,
    version: String,
    cores: u32,
    memory_bytes: u64,
    kernel: String,
    log: String,
    machine: String,
}

impl From<&WorkerStatus> for WorkerJson {
    fn from(w: &WorkerStatus) -> Self {
        Self {
            worker_id: w.id.to_string(),
            label: w.label.clone(),
            threads: w.threads,
            leases: w.leases,
            jobs_done: w.jobs_done,
            silent_ms: w.silent_ms,
            state: w.state.to_string(),
            suspended_ms: w.suspended_ms,
            version: w.version.clone(),
            cores: w.facts.cores,
            memory_bytes: w.facts.memory_bytes,
            kernel: w.facts.kernel.clone(),
            log: w.facts.log.clone(),
            machine: w.machine.clone(),
        }
    }
}
