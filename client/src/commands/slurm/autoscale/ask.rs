//! Fetches the state of the farm for the autoscaler.

use std::time::Duration;

use anyhow::Result;
use farm_proto::status::{DictionaryState, DictionaryStatus, WorkerState};
use farm_proto::wire::{ListEventsRequest, StatusRequest};

use crate::commands::dictionaries::list;
use crate::commands::farm::workers;
use crate::connection::Connection;
use crate::slurm::scaling::{Demand, TaskId};

/// Page token of the end of the events.
pub(super) async fn newest_events(connection: &Connection) -> Result<String> {
    let request = ListEventsRequest { page_size: 1, newest: true, ..ListEventsRequest::default() };
    Ok(connection.farm().list_events(request).await?.into_inner().next_page_token)
}

/// The demand of the farm and its workers.
pub(super) struct FarmState {
    pub(super) demand: Demand,
    /// Workers that are connected.
    pub(super) registered: Vec<TaskId>,
    /// Workers that have joined, and may have left again.
    pub(super) joined: Vec<TaskId>,
    /// Page token of the next events.
    pub(super) events: String,
}

pub(super) async fn ask(connection: &Connection, since: String) -> Result<FarmState> {
    let status = connection.farm().status(StatusRequest {}).await?.into_inner();
    let demand = Demand {
        waiting: status.jobs_pending,
        computing: status.jobs_leased,
        left: time_left(&list::fetch(connection).await?),
    };
    let workers = workers::fetch(connection).await?;
    let there = workers.iter().filter(|worker| worker.state != WorkerState::Silent);
    let registered = there.filter_map(|worker| task(&worker.label)).collect();
    let (mut joined, mut events) = (Vec::new(), since);
    loop {
        let request =
            ListEventsRequest { page_size: 1000, page_token: events, ..ListEventsRequest::default() };
        let page = connection.farm().list_events(request).await?.into_inner();
        events = page.next_page_token;
        if page.events.is_empty() {
            return Ok(FarmState { demand, registered, joined, events });
        }
        let joins = page.events.iter().filter(|event| event.kind == "WORKER_JOINED");
        joined.extend(joins.filter_map(|event| task(&event.worker)));
    }
}

/// Time until the last of the running dictionaries is done; `None` while one of them has no estimate.
fn time_left(dictionaries: &[DictionaryStatus]) -> Option<Duration> {
    let running = dictionaries.iter().filter(|d| d.state == DictionaryState::Running);
    let left_s = running.map(|d| d.eta_s).try_fold(0.0, |most: f64, eta_s| Some(most.max(eta_s?)))?;
    Duration::try_from_secs_f64(left_s).ok()
}

/// The task in the label that the job script gives its worker: slurm:JOB.TASK@NODE.
fn task(label: &str) -> Option<TaskId> {
    let (job, task) = label.strip_prefix("slurm:")?.split('@').next()?.split_once('.')?;
    Some(TaskId { job: job.parse().ok()?, task: task.parse().ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A worker is matched by the label of the job script.
    #[test]
    fn worker_is_matched_by_its_script_label() {
        assert_eq!(task("slurm:17.2@node1"), Some(TaskId { job: 17, task: 2 }));
        for label in ["node1", "slurm:17@node1", "slurm:17.x@node1", "pbs:17.2@node1"] {
            assert_eq!(task(label), None, "{label}");
        }
    }
}
