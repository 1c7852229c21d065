use anyhow::Result;
use farm_proto::status::{DictionaryStatus, WorkerStatus};
use farm_proto::wire::{StatusRequest, StatusResponse};
use serde::Serialize;

use super::list;
use crate::cli::Global;
use crate::connection::{Connection, Purpose, with_farm};
use crate::output::{DictionaryJson, Output, WorkerJson, grouped, table};

#[derive(Debug, Serialize)]
struct StatusJson {
    address: Option<String>,
    version: String,
    physics_version: u32,
    jobs_pending: u64,
    jobs_leased: u64,
    workers: Vec<WorkerJson>,
    dictionaries: Vec<DictionaryJson>,
}

pub(crate) async fn run(global: &Global, output: &Output) -> Result<()> {
    let (address, status, workers, dictionaries) = with_farm(global, Purpose::Ask, fetch).await?;
    let data = StatusJson {
        address: address.clone(),
        version: status.version.clone(),
        physics_version: status.physics_version,
        jobs_pending: status.jobs_pending,
        jobs_leased: status.jobs_leased,
        workers: workers.iter().map(Into::into).collect(),
        dictionaries: dictionaries.iter().map(Into::into).collect(),
    };
    output.print("status", &data, || text(address.as_deref(), &status, &workers, &dictionaries))
}

type Answer = (Option<String>, StatusResponse, Vec<WorkerStatus>, Vec<DictionaryStatus>);

async fn fetch(connection: &Connection) -> Result<Answer> {
    // A coordinator that this command has just started for itself is not one that runs.
    let address = (!connection.is_embedded()).then(|| connection.address().to_owned());
    let mut status = connection.farm().status(StatusRequest {}).await?.into_inner();
    let workers = std::mem::take(&mut status.workers).into_iter().map(Into::into).collect();
    Ok((address, status, workers, list::fetch(connection).await?))
}

fn text(
    address: Option<&str>,
    status: &StatusResponse,
    workers: &[WorkerStatus],
    dictionaries: &[DictionaryStatus],
) -> String {
    let place = match address {
        Some(address) => format!("coordinator {} at {address}", status.version),
        None => "no coordinator is running; this is what its folder holds".to_owned(),
    };
    let jobs = format!(
        "{} jobs wait, {} are being computed",
        grouped(status.jobs_pending),
        grouped(status.jobs_leased)
    );
    let mut text = format!("{place}\n{jobs}\n\n{}", list::text(dictionaries));
    if !workers.is_empty() {
        let row = |w: &WorkerStatus| {
            let silent = format!("{:.1} s", w.silent_ms as f64 / 1000.0);
            vec![
                w.label.clone(),
                w.threads.to_string(),
                w.leases.to_string(),
                w.jobs_done.to_string(),
                silent,
            ]
        };
        let head = ["worker", "threads", "leases", "jobs done", "silent for"];
        text += &format!("\n\n{}", table(&head, &[1, 2, 3, 4], workers.iter().map(row)));
    }
    text
}
