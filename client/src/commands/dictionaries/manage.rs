//! Pauses, resumes, cancels, retries, prioritises and deletes dictionaries.

use anyhow::{Result, ensure};
use clap::Args;
use farm_proto::DictionaryName;
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::{
    CancelRequest, DeleteRequest, Dictionary, PauseRequest, ResumeRequest, RetryRequest, SetPriorityRequest,
};
use serde::Serialize;

use super::watch::line;
use crate::cli::Global;
use crate::connection::{Connection, Purpose, patient, with_farm};
use crate::output::{DictionaryJson, Output, grouped};

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  farmctl cancel fine --reason superseded         `farmctl resume fine` carries on")]
pub(crate) struct CancelArgs {
    /// Name of the dictionary.
    name: String,
    /// Reason; it is kept with the dictionary and shown with it.
    #[arg(long, value_name = "TEXT", default_value = "")]
    reason: String,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl priority fine 10                        before everything of priority 0
  farmctl priority fine -10                       when nothing else is left to do")]
pub(crate) struct PriorityArgs {
    /// Name of the dictionary.
    name: String,
    /// From -1000 to 1000; higher goes first, 0 is the default.
    #[arg(allow_negative_numbers = true)]
    priority: i32,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  farmctl delete fine --yes")]
pub(crate) struct DeleteArgs {
    /// Name of the dictionary.
    name: String,
    /// Confirm; nothing is deleted without this.
    #[arg(long)]
    yes: bool,
}

pub(crate) async fn pause(global: &Global, name: &str, output: &Output) -> Result<()> {
    change(global, name, "pause", output, async |connection, name| {
        Ok(connection.dictionaries().pause(PauseRequest { name }).await?.into_inner())
    })
    .await
}

pub(crate) async fn resume(global: &Global, name: &str, output: &Output) -> Result<()> {
    change(global, name, "resume", output, async |connection, name| {
        Ok(connection.dictionaries().resume(ResumeRequest { name }).await?.into_inner())
    })
    .await
}

pub(crate) async fn cancel(global: &Global, args: CancelArgs, output: &Output) -> Result<()> {
    change(global, &args.name, "cancel", output, async |connection, name| {
        let request = CancelRequest { name, reason: args.reason.clone() };
        Ok(connection.dictionaries().cancel(request).await?.into_inner())
    })
    .await
}

pub(crate) async fn retry(global: &Global, name: &str, output: &Output) -> Result<()> {
    change(global, name, "retry", output, async |connection, name| {
        Ok(connection.dictionaries().retry(RetryRequest { name }).await?.into_inner())
    })
    .await
}

pub(crate) async fn priority(global: &Global, args: PriorityArgs, output: &Output) -> Result<()> {
    change(global, &args.name, "priority", output, async |connection, name| {
        let request = SetPriorityRequest { name, priority: args.priority };
        Ok(connection.dictionaries().set_priority(request).await?.into_inner())
    })
    .await
}

async fn change(
    global: &Global,
    name: &str,
    kind: &str,
    output: &Output,
    call: impl AsyncFn(&Connection, String) -> Result<Dictionary>,
) -> Result<()> {
    let name = DictionaryName::new(name)?;
    let changed =
        with_farm(global, Purpose::Ask, async |connection| call(connection, name.to_string()).await).await?;
    let status = DictionaryStatus::try_from(changed)?;
    output.print(kind, &DictionaryJson::from(&status), || line(&status))
}

#[derive(Debug, Serialize)]
struct DeleteJson {
    name: String,
    records_deleted: u64,
}

pub(crate) async fn delete(global: &Global, args: DeleteArgs, output: &Output) -> Result<()> {
    let name = DictionaryName::new(args.name)?;
    ensure!(args.yes, "this deletes {name} and its records for good: add --yes to do it");
    let records_deleted = with_farm(global, Purpose::Ask, async |connection| {
        let request = DeleteRequest { name: name.to_string() };
        Ok(connection.dictionaries().delete(patient(request)).await?.into_inner().records_deleted)
    })
    .await?;
    let data = DeleteJson { name: name.to_string(), records_deleted };
    output.print("delete", &data, || format!("{name}: deleted, {} records with it", grouped(records_deleted)))
}
