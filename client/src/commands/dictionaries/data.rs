//! Implements `farmctl data`: lists what takes room in a farm, and deletes what will not be finished.

use anyhow::{Context, Result};
use clap::Args;
use farm_lab::document::{Block, ValueTable};
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::{DeleteRequest, StatusRequest};
use serde::Serialize;

use super::forecast::job_bytes;
use super::list;
use crate::cli::Global;
use crate::connection::{Connection, Purpose, patient, with_farm};
use crate::output::{Output, grouped, state, utc};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl data
  farmctl data --remove-unfinished --yes          interrupted, cancelled and outdated ones
  farmctl delete fine --yes                       one that is no longer needed")]
pub(crate) struct DataArgs {
    /// Delete all dictionaries that nothing computes and that are not done, with the records that no other one uses.
    #[arg(long, requires = "yes")]
    remove_unfinished: bool,
    /// Confirm; nothing is deleted without this.
    #[arg(long)]
    yes: bool,
}

#[derive(Debug, Serialize)]
struct DataJson {
    database_bytes: u64,
    dictionaries: Vec<RoomJson>,
    removed: Vec<String>,
}

/// The room of a dictionary.
#[derive(Debug, Serialize)]
struct RoomJson {
    name: String,
    state: String,
    records_done: usize,
    bytes: u64,
    created_unix_ms: u64,
}

pub(crate) async fn run(global: &Global, args: &DataArgs, output: &Output) -> Result<()> {
    let data = with_farm(global, Purpose::Ask, async |connection| fetch(connection, args).await).await?;
    output.answer("data", &data, || blocks(&data))
}

async fn fetch(connection: &Connection, args: &DataArgs) -> Result<DataJson> {
    let mut removed = Vec::new();
    let mut dictionaries = list::fetch(connection).await?;
    if args.remove_unfinished {
        for unfinished in dictionaries.extract_if(.., |d| is_unfinished(d)) {
            let request = DeleteRequest { name: unfinished.name.to_string() };
            let deleted = connection.dictionaries().delete(patient(request)).await;
            let before = || format!("{} of the unfinished ones are deleted", removed.len());
            deleted.with_context(before)?;
            removed.push(unfinished.name.to_string());
        }
    }
    let database_bytes = connection.farm().status(StatusRequest {}).await?.into_inner().database_bytes;
    let mut dictionaries: Vec<RoomJson> = dictionaries.iter().map(Into::into).collect();
    dictionaries.sort_by_key(|room| std::cmp::Reverse(room.bytes));
    Ok(DataJson { database_bytes, dictionaries, removed })
}

fn is_unfinished(status: &DictionaryStatus) -> bool {
    use DictionaryState::{Cancelled, Failed, Outdated};
    matches!(status.state(), Cancelled | Failed | Outdated)
}

impl From<&DictionaryStatus> for RoomJson {
    fn from(status: &DictionaryStatus) -> Self {
        Self {
            name: status.name.to_string(),
            state: state(status),
            records_done: status.records_done(),
            bytes: status.jobs_done as u64 * job_bytes(&status.grid),
            created_unix_ms: status.created_unix_ms,
        }
    }
}

fn blocks(data: &DataJson) -> Vec<Block> {
    let megabytes = |bytes: u64| format!("{:.1} MB", bytes as f64 / 1e6);
    let row = |room: &RoomJson| {
        let records = grouped(room.records_done as u64);
        let day = utc(room.created_unix_ms).chars().take(10).collect();
        vec![room.name.clone(), room.state.clone(), records, megabytes(room.bytes), day]
    };
    let head = "dictionary | state | >records | >room | created";
    let removed = (!data.removed.is_empty()).then(|| format!("removed: {}", data.removed.join(", ")));
    let whole =
        format!("{} in all; records that dictionaries share count for each", megabytes(data.database_bytes));
    let remedy = "`farmctl delete NAME --yes` deletes one; `measure` computes it again where it needs it";
    let table = (!data.dictionaries.is_empty())
        .then(|| ValueTable::new(head, data.dictionaries.iter().map(row)).block());
    let words = removed.into_iter().chain([whole, remedy.to_owned()]).map(Block::Paragraph);
    table.into_iter().chain(words).collect()
}
