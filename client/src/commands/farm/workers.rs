//! Implements `farmctl workers`: lists the workers, and lets one leave.

use anyhow::Result;
use clap::{Args, Subcommand};
use farm_proto::status::{MachineFacts, WorkerStatus};
use farm_proto::wire::{DrainWorkerRequest, ListWorkersRequest};
use serde::Serialize;

use crate::cli::Global;
use crate::connection::{Connection, Purpose, with_farm};
use crate::output::{Output, WorkerJson, table};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl workers
  farmctl workers drain node7:4711                let this one finish its jobs and leave")]
pub(crate) struct WorkersArgs {
    #[command(subcommand)]
    command: Option<WorkersCommand>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum WorkersCommand {
    /// List the workers; the same as no subcommand.
    List,
    /// Let a worker finish its jobs and leave.
    Drain(DrainArgs),
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  farmctl workers drain node7:4711")]
pub(crate) struct DrainArgs {
    /// Id or label of the worker, as `farmctl workers` shows them.
    worker: String,
}

#[derive(Debug, Serialize)]
pub(crate) struct WorkersJson {
    workers: Vec<WorkerJson>,
}

#[derive(Debug, Serialize)]
struct DrainJson {
    worker_id: String,
}

pub(crate) async fn run(global: &Global, args: WorkersArgs, output: &Output) -> Result<()> {
    match args.command {
        None | Some(WorkersCommand::List) => list(global, output).await,
        Some(WorkersCommand::Drain(args)) => drain(global, &args.worker, output).await,
    }
}

async fn list(global: &Global, output: &Output) -> Result<()> {
    let workers = with_farm(global, Purpose::Ask, fetch).await?;
    output.print("workers", &data(&workers), || text(&workers))
}

pub(crate) fn data(workers: &[WorkerStatus]) -> WorkersJson {
    WorkersJson { workers: workers.iter().map(Into::into).collect() }
}

async fn drain(global: &Global, worker: &str, output: &Output) -> Result<()> {
    let worker_id = with_farm(global, Purpose::Ask, async |connection| {
        let request = DrainWorkerRequest { worker: worker.to_owned() };
        Ok(connection.admin().drain_worker(request).await?.into_inner().worker_id)
    })
    .await?;
    output.print("drain", &DrainJson { worker_id }, || format!("{worker} finishes what it has and ends"))
}

pub(crate) async fn fetch(connection: &Connection) -> Result<Vec<WorkerStatus>> {
    let (mut workers, mut page_token) = (Vec::new(), String::new());
    loop {
        let request = ListWorkersRequest { page_size: 0, page_token };
        let page = connection.farm().list_workers(request).await?.into_inner();
        for worker in page.workers {
            workers.push(worker.try_into()?);
        }
        page_token = page.next_page_token;
        if page_token.is_empty() {
            return Ok(workers);
        }
    }
}

/// For example `16 cores, 64 GiB, avx2`.
fn machine(facts: &MachineFacts) -> String {
    if facts.kernel.is_empty() {
        return String::new();
    }
    let gib = facts.memory_bytes as f64 / f64::from(1 << 30);
    let memory = if gib < 4.0 { format!("{gib:.1} GiB") } else { format!("{gib:.0} GiB") };
    format!("{} cores, {memory}, {}", facts.cores, facts.kernel)
}

pub(crate) fn text(workers: &[WorkerStatus]) -> String {
    if workers.is_empty() {
        return "no worker is registered".to_owned();
    }
    let row = |w: &WorkerStatus| {
        let heard = format!("{:.1} s ago", w.silent_ms as f64 / 1000.0);
        let state = match w.suspended_ms {
            0 => w.state.to_string(),
            left => format!("{} for {} s", w.state, left.div_ceil(1000)),
        };
        let id = w.id.0.chars().take(8).collect();
        vec![
            w.label.clone(),
            id,
            state,
            w.threads.to_string(),
            w.leases.to_string(),
            w.jobs_done.to_string(),
            heard,
            machine(&w.facts),
            w.version.clone(),
        ]
    };
    let head = "worker | id | state | >threads | >leases | >results | >heard of | machine | version";
    table(head, workers.iter().map(row))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A small memory is shown with more digits.
    #[test]
    fn small_memory_has_more_digits() {
        let text = |mib: u64| {
            let kernel = "avx2".to_owned();
            machine(&MachineFacts { cores: 2, memory_bytes: mib << 20, kernel, log: String::new() })
        };
        assert_eq!([text(64 << 10), text(300)], ["2 cores, 64 GiB, avx2", "2 cores, 0.3 GiB, avx2"]);
    }
}
