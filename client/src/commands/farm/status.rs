//! Implements `farmctl status`: prints what the farm is doing.

use anyhow::Result;
use farm_proto::status::{DictionaryStatus, WorkerStatus};
use farm_proto::wire::{StatusRequest, StatusResponse};
use serde::Serialize;

use super::workers;
use crate::cli::Global;
use crate::commands::dictionaries::list;
use crate::connection::{Connection, Purpose, with_farm};
use crate::output::{DictionaryJson, Output, WorkerJson, counted, grouped};

#[derive(Debug, Serialize)]
pub(crate) struct StatusJson {
    address: Option<String>,
    version: String,
    physics_version: u32,
    jobs_pending: u64,
    jobs_leased: u64,
    jobs_done: u64,
    uptime_ms: u64,
    database_bytes: u64,
    checks_agreed: u64,
    checks_disputed: u64,
    checks_waiting: u64,
    store_fault: Option<String>,
    workers: Vec<WorkerJson>,
    dictionaries: Vec<DictionaryJson>,
}

pub(crate) async fn run(global: &Global, output: &Output) -> Result<()> {
    let (address, status, workers, dictionaries) = with_farm(global, Purpose::Ask, fetch).await?;
    let data = data(address.as_deref(), &status, &workers, &dictionaries);
    output.print("status", &data, || text(address.as_deref(), &status, &workers, &dictionaries))
}

pub(crate) fn data(
    address: Option<&str>,
    status: &StatusResponse,
    workers: &[WorkerStatus],
    dictionaries: &[DictionaryStatus],
) -> StatusJson {
    StatusJson {
        address: address.map(str::to_owned),
        version: status.version.clone(),
        physics_version: status.physics_version,
        jobs_pending: status.jobs_pending,
        jobs_leased: status.jobs_leased,
        jobs_done: status.jobs_done,
        uptime_ms: status.uptime_ms,
        database_bytes: status.database_bytes,
        checks_agreed: status.checks_agreed,
        checks_disputed: status.checks_disputed,
        checks_waiting: status.checks_waiting,
        store_fault: (!status.store_fault.is_empty()).then(|| status.store_fault.clone()),
        workers: workers.iter().map(Into::into).collect(),
        dictionaries: dictionaries.iter().map(Into::into).collect(),
    }
}

type FarmOverview = (Option<String>, StatusResponse, Vec<WorkerStatus>, Vec<DictionaryStatus>);

async fn fetch(connection: &Connection) -> Result<FarmOverview> {
    // A coordinator that only this command has started does not count as running.
    let address = (!connection.is_embedded()).then(|| connection.address().to_owned());
    let status = connection.farm().status(StatusRequest {}).await?.into_inner();
    Ok((address, status, workers::fetch(connection).await?, list::fetch(connection).await?))
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
    let fault = match status.store_fault.as_str() {
        "" => String::new(),
        fault => format!("\nresults cannot be stored: {fault}"),
    };
    let checks = match status.checks_waiting {
        0 => String::new(),
        waiting => {
            format!(
                "\n{} to be checked: the coordinator computes them once more (nothing else waits for it)",
                counted(waiting, "result")
            )
        }
    };
    let mut text = format!("{place}\n{jobs}{checks}{fault}\n\n{}", list::text(dictionaries));
    if !workers.is_empty() {
        text += &format!("\n\n{}", workers::text(workers));
    }
    text
}
