//! Converts the progress of dictionaries and workers.

use super::mirror::{Numbered, list, mirror, mirror_enum, number, optional, required};
use super::shortened;
use crate::ids::{DictionaryName, WorkerId};
use crate::status::{
    DictionaryState, DictionaryStatus, FAILED_JOBS, FailedJob, JobState, MachineFacts, WorkerState,
    WorkerStatus,
};
use crate::wire;
use optics_model::digest::Digest;
use optics_model::grid::Grid;
use optics_model::invalid::{Invalid, Result};

mirror_enum!(DictionaryState { Running, Done, Failed, Paused, Cancelled, Outdated });
mirror_enum!(JobState { Waiting, Computing, Done, Checked, Failed });
mirror_enum!(WorkerState { Working, Idle, Draining, Fenced, Silent, Suspended });
mirror!(FailedJob { job, reason, quarantined });
mirror!(MachineFacts { cores, memory_bytes, kernel, log });

impl wire::JobStates {
    /// States of consecutive jobs, from `first` on.
    pub fn new(first: u32, states: &[JobState]) -> Self {
        Self { first, states: states.iter().map(|state| state.number() as u8).collect() }
    }

    /// The first job, and the states from it on.
    pub fn read(&self) -> Result<(usize, Vec<JobState>)> {
        let state = |byte: &u8| number::from_wire("state", i32::from(*byte)).map_err(|e| e.renamed("states"));
        Ok((self.first as usize, self.states.iter().map(state).collect::<Result<_>>()?))
    }
}

impl From<&DictionaryStatus> for wire::Dictionary {
    fn from(status: &DictionaryStatus) -> Self {
        Self {
            name: status.name.to_string(),
            grid: Some(listed(&status.grid)),
            grid_digest: status.grid_digest.to_string(),
            records_digest: status.records_digest.map(|d| d.to_string()).unwrap_or_default(),
            created_unix_ms: status.created_unix_ms,
            state: status.state.number(),
            records_total: status.records_total() as u64,
            records_done: status.records_done() as u64,
            jobs_total: status.jobs_total() as u64,
            jobs_done: status.jobs_done as u64,
            jobs_leased: status.jobs_leased as u64,
            failed: status.failed.iter().take(FAILED_JOBS).cloned().map(Into::into).collect(),
            work_done: status.work_done,
            priority: status.priority,
            reason: status.reason.clone(),
            owner: status.owner.clone(),
            eta_s: status.eta_s,
            goes_first: status.goes_first.as_ref().map(ToString::to_string).unwrap_or_default(),
            records_reused: status.records_reused as u64,
            walks_min: status.walks.0,
            walks_max: status.walks.1,
            jobs_disputed: status.jobs_disputed as u64,
            jobs_failed: status.jobs_failed as u64,
        }
    }
}

/// A grid for lists, with shortened names: one that was stored by an older version may have names of megabytes.
fn listed(grid: &Grid) -> wire::Grid {
    let mut grid = wire::Grid::from(grid);
    if let Some(scene) = &mut grid.scene {
        scene.layers.iter_mut().for_each(|layer| shortened(&mut layer.name));
        scene.channels.iter_mut().for_each(|channel| shortened(&mut channel.name));
    }
    grid
}

impl TryFrom<wire::Dictionary> for DictionaryStatus {
    type Error = Invalid;

    fn try_from(d: wire::Dictionary) -> Result<Self> {
        let digest = |field: &str, hex: &str| {
            Digest::from_hex(hex).ok_or_else(|| Invalid::new(field, hex, "64 hexadecimal digits are needed"))
        };
        Ok(Self {
            name: DictionaryName::new(d.name)?,
            grid: Grid::try_from(required("grid", d.grid)?).map_err(|e| e.within("grid"))?,
            grid_digest: digest("grid_digest", &d.grid_digest)?,
            records_digest: match d.records_digest.as_str() {
                "" => None,
                hex => Some(digest("records_digest", hex)?),
            },
            created_unix_ms: d.created_unix_ms,
            state: number::from_wire("state", d.state)?,
            jobs_done: d.jobs_done as usize,
            jobs_leased: d.jobs_leased as usize,
            jobs_disputed: d.jobs_disputed as usize,
            // Older coordinators send the failed jobs without their number.
            jobs_failed: d.failed.len().max(d.jobs_failed as usize),
            failed: list::from_wire("failed", d.failed)?,
            work_done: d.work_done,
            priority: d.priority,
            reason: d.reason,
            owner: d.owner,
            eta_s: d.eta_s,
            goes_first: match d.goes_first.as_str() {
                "" => None,
                name => Some(DictionaryName::new(name)?),
            },
            records_reused: d.records_reused as usize,
            walks: (d.walks_min, d.walks_max),
        })
    }
}

impl From<WorkerStatus> for wire::Worker {
    fn from(w: WorkerStatus) -> Self {
        Self {
            worker_id: w.id.0,
            label: w.label,
            threads: w.threads,
            leases: w.leases,
            jobs_done: w.jobs_done,
            silent_ms: w.silent_ms,
            state: w.state.number(),
            version: w.version,
            suspended_ms: w.suspended_ms,
            facts: Some(w.facts.into()),
            machine: w.machine,
        }
    }
}

impl TryFrom<wire::Worker> for WorkerStatus {
    type Error = Invalid;

    fn try_from(w: wire::Worker) -> Result<Self> {
        Ok(Self {
            id: WorkerId(w.worker_id),
            label: w.label,
            threads: w.threads,
            leases: w.leases,
            jobs_done: w.jobs_done,
            silent_ms: w.silent_ms,
            state: number::from_wire("state", w.state)?,
            suspended_ms: w.suspended_ms,
            version: w.version,
            facts: optional::from_wire("facts", w.facts)?.unwrap_or_default(),
            machine: w.machine,
        })
    }
}
