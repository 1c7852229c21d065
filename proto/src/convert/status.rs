//! Progress of dictionaries and workers.

use super::{required, shortened};
use crate::ids::{DictionaryName, WorkerId};
use crate::status::{
    DictionaryState, DictionaryStatus, FAILED_JOBS, FailedJob, JobState, MachineFacts, WorkerState,
    WorkerStatus,
};
use crate::wire;
use optics_model::digest::Digest;
use optics_model::grid::Grid;
use optics_model::invalid::{Invalid, Result};

impl From<DictionaryState> for wire::DictionaryState {
    fn from(state: DictionaryState) -> Self {
        match state {
            DictionaryState::Running => Self::Running,
            DictionaryState::Done => Self::Done,
            DictionaryState::Failed => Self::Failed,
            DictionaryState::Paused => Self::Paused,
            DictionaryState::Cancelled => Self::Cancelled,
            DictionaryState::Outdated => Self::Outdated,
        }
    }
}

fn state(number: i32) -> Result<DictionaryState> {
    match wire::DictionaryState::try_from(number) {
        Ok(wire::DictionaryState::Running) => Ok(DictionaryState::Running),
        Ok(wire::DictionaryState::Done) => Ok(DictionaryState::Done),
        Ok(wire::DictionaryState::Failed) => Ok(DictionaryState::Failed),
        Ok(wire::DictionaryState::Paused) => Ok(DictionaryState::Paused),
        Ok(wire::DictionaryState::Cancelled) => Ok(DictionaryState::Cancelled),
        Ok(wire::DictionaryState::Outdated) => Ok(DictionaryState::Outdated),
        Ok(wire::DictionaryState::Unspecified) | Err(_) => {
            Err(Invalid::new("state", number, "a state that this version knows is needed"))
        }
    }
}

impl From<JobState> for wire::JobState {
    fn from(state: JobState) -> Self {
        match state {
            JobState::Waiting => Self::Waiting,
            JobState::Computing => Self::Computing,
            JobState::Done => Self::Done,
            JobState::Checked => Self::Checked,
            JobState::Failed => Self::Failed,
        }
    }
}

impl wire::JobStates {
    /// States of jobs that follow each other.
    pub fn new(first: u32, states: &[JobState]) -> Self {
        Self { first, states: states.iter().map(|state| wire::JobState::from(*state) as u8).collect() }
    }

    /// The first job, and the states from it on.
    pub fn read(&self) -> Result<(usize, Vec<JobState>)> {
        let state = |byte: &u8| {
            let known = JobState::ALL.into_iter().find(|state| wire::JobState::from(*state) as u8 == *byte);
            known.ok_or_else(|| Invalid::new("states", byte, "a state that this version knows is needed"))
        };
        Ok((self.first as usize, self.states.iter().map(state).collect::<Result<_>>()?))
    }
}

impl From<&FailedJob> for wire::FailedJob {
    fn from(failed: &FailedJob) -> Self {
        Self { job: failed.job, reason: failed.reason.clone(), quarantined: failed.quarantined }
    }
}

impl From<wire::FailedJob> for FailedJob {
    fn from(failed: wire::FailedJob) -> Self {
        Self { job: failed.job, reason: failed.reason, quarantined: failed.quarantined }
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
            state: wire::DictionaryState::from(status.state).into(),
            records_total: status.records_total() as u64,
            records_done: status.records_done() as u64,
            jobs_total: status.jobs_total() as u64,
            jobs_done: status.jobs_done as u64,
            jobs_leased: status.jobs_leased as u64,
            failed: status.failed.iter().take(FAILED_JOBS).map(Into::into).collect(),
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

/// A grid as lists show it: one that was stored by an older version may have names of megabytes.
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
            state: state(d.state)?,
            jobs_done: d.jobs_done as usize,
            jobs_leased: d.jobs_leased as usize,
            jobs_disputed: d.jobs_disputed as usize,
            // One of before tells the jobs alone.
            jobs_failed: d.failed.len().max(d.jobs_failed as usize),
            failed: d.failed.into_iter().map(Into::into).collect(),
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

impl From<WorkerState> for wire::WorkerState {
    fn from(state: WorkerState) -> Self {
        match state {
            WorkerState::Working => Self::Working,
            WorkerState::Idle => Self::Idle,
            WorkerState::Draining => Self::Draining,
            WorkerState::Fenced => Self::Fenced,
            WorkerState::Silent => Self::Silent,
            WorkerState::Suspended => Self::Suspended,
        }
    }
}

impl From<MachineFacts> for wire::MachineFacts {
    fn from(facts: MachineFacts) -> Self {
        Self { cores: facts.cores, memory_bytes: facts.memory_bytes, kernel: facts.kernel, log: facts.log }
    }
}

impl From<wire::MachineFacts> for MachineFacts {
    fn from(facts: wire::MachineFacts) -> Self {
        Self { cores: facts.cores, memory_bytes: facts.memory_bytes, kernel: facts.kernel, log: facts.log }
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
            state: wire::WorkerState::from(w.state).into(),
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
        let state = match wire::WorkerState::try_from(w.state) {
            Ok(wire::WorkerState::Working) => WorkerState::Working,
            Ok(wire::WorkerState::Idle) => WorkerState::Idle,
            Ok(wire::WorkerState::Draining) => WorkerState::Draining,
            Ok(wire::WorkerState::Fenced) => WorkerState::Fenced,
            Ok(wire::WorkerState::Silent) => WorkerState::Silent,
            Ok(wire::WorkerState::Suspended) => WorkerState::Suspended,
            Ok(wire::WorkerState::Unspecified) | Err(_) => {
                return Err(Invalid::new("state", w.state, "a state that this version knows is needed"));
            }
        };
        Ok(Self {
            id: WorkerId(w.worker_id),
            label: w.label,
            threads: w.threads,
            leases: w.leases,
            jobs_done: w.jobs_done,
            silent_ms: w.silent_ms,
            state,
            suspended_ms: w.suspended_ms,
            version: w.version,
            facts: w.facts.map(Into::into).unwrap_or_default(),
            machine: w.machine,
        })
    }
}
