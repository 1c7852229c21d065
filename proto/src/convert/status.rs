//! Progress of dictionaries and workers.

use super::required;
use crate::digest::Digest;
use crate::grid::Grid;
use crate::ids::{DictionaryName, WorkerId};
use crate::invalid::{Invalid, Result};
use crate::status::{DictionaryState, DictionaryStatus, FailedJob, WorkerStatus};
use crate::wire;

impl From<DictionaryState> for wire::DictionaryState {
    fn from(state: DictionaryState) -> Self {
        match state {
            DictionaryState::Running => Self::Running,
            DictionaryState::Done => Self::Done,
            DictionaryState::Failed => Self::Failed,
        }
    }
}

impl From<&DictionaryStatus> for wire::Dictionary {
    fn from(status: &DictionaryStatus) -> Self {
        let failed = |f: &FailedJob| wire::FailedJob { job: f.job, reason: f.reason.clone() };
        Self {
            name: status.name.to_string(),
            grid: Some((&status.grid).into()),
            grid_digest: status.grid_digest.to_string(),
            records_digest: status.records_digest.map(|d| d.to_string()).unwrap_or_default(),
            created_unix_ms: status.created_unix_ms,
            state: wire::DictionaryState::from(status.state()).into(),
            records_total: status.records_total() as u64,
            records_done: status.records_done() as u64,
            jobs_total: status.jobs_total() as u64,
            jobs_done: status.jobs_done as u64,
            jobs_leased: status.jobs_leased as u64,
            failed: status.failed.iter().map(failed).collect(),
            work_done: status.work_done,
        }
    }
}

impl TryFrom<wire::Dictionary> for DictionaryStatus {
    type Error = Invalid;

    fn try_from(d: wire::Dictionary) -> Result<Self> {
        let digest = |field: &str, hex: &str| {
            Digest::from_hex(hex).ok_or_else(|| Invalid::new(field, hex, "64 hexadecimal digits are needed"))
        };
        let failed = |f: wire::FailedJob| FailedJob { job: f.job, reason: f.reason };
        Ok(Self {
            name: DictionaryName::new(d.name)?,
            grid: Grid::try_from(required("grid", d.grid)?).map_err(|e| e.within("grid"))?,
            grid_digest: digest("grid_digest", &d.grid_digest)?,
            records_digest: match d.records_digest.as_str() {
                "" => None,
                hex => Some(digest("records_digest", hex)?),
            },
            created_unix_ms: d.created_unix_ms,
            jobs_done: d.jobs_done as usize,
            jobs_leased: d.jobs_leased as usize,
            failed: d.failed.into_iter().map(failed).collect(),
            work_done: d.work_done,
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
        }
    }
}

impl From<wire::Worker> for WorkerStatus {
    fn from(w: wire::Worker) -> Self {
        Self {
            id: WorkerId(w.worker_id),
            label: w.label,
            threads: w.threads,
            leases: w.leases,
            jobs_done: w.jobs_done,
            silent_ms: w.silent_ms,
        }
    }
}
