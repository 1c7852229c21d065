use anyhow::Result;
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::ListRequest;
use serde::Serialize;

use crate::cli::Global;
use crate::connection::{Connection, Purpose, with_farm};
use crate::output::{DictionaryJson, Output, grouped, table};

#[derive(Debug, Serialize)]
struct ListJson {
    dictionaries: Vec<DictionaryJson>,
}

pub(crate) async fn run(global: &Global, output: &Output) -> Result<()> {
    let dictionaries = with_farm(global, Purpose::Ask, fetch).await?;
    let data = ListJson { dictionaries: dictionaries.iter().map(Into::into).collect() };
    output.print("list", &data, || text(&dictionaries))
}

pub(crate) async fn fetch(connection: &Connection) -> Result<Vec<DictionaryStatus>> {
    let list = connection.dictionaries().list(ListRequest {}).await?.into_inner().dictionaries;
    Ok(list.into_iter().map(TryInto::try_into).collect::<Result<_, _>>()?)
}

pub(crate) fn text(dictionaries: &[DictionaryStatus]) -> String {
    if dictionaries.is_empty() {
        return "no dictionaries yet: `farmctl submit` computes one".to_owned();
    }
    let head = ["dictionary", "state", "records", "of", "done", "failed jobs"];
    let row = |d: &DictionaryStatus| {
        vec![
            d.name.to_string(),
            d.state().as_str().to_owned(),
            grouped(d.records_done() as u64),
            grouped(d.records_total() as u64),
            format!("{:.1} %", 100.0 * d.work_done),
            d.failed.len().to_string(),
        ]
    };
    table(&head, &[2, 3, 4, 5], dictionaries.iter().map(row))
}
