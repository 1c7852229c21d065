//! Implements `farmctl list`, and fetches the list of dictionaries for other verbs.

use anyhow::Result;
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::ListRequest;
use serde::Serialize;

use crate::cli::Global;
use crate::connection::{Connection, Purpose, with_farm};
use crate::output::{DictionaryJson, Output, duration, grouped, share_of_work, state, table};

#[derive(Debug, Serialize)]
pub(crate) struct ListJson {
    dictionaries: Vec<DictionaryJson>,
}

pub(crate) async fn run(global: &Global, output: &Output) -> Result<()> {
    let dictionaries = with_farm(global, Purpose::Ask, fetch).await?;
    output.print("list", &data(&dictionaries), || text(&dictionaries))
}

pub(crate) fn data(dictionaries: &[DictionaryStatus]) -> ListJson {
    ListJson { dictionaries: dictionaries.iter().map(Into::into).collect() }
}

pub(crate) async fn fetch(connection: &Connection) -> Result<Vec<DictionaryStatus>> {
    let (mut dictionaries, mut page_token) = (Vec::new(), String::new());
    loop {
        let request = ListRequest { page_size: 0, page_token };
        let page = connection.dictionaries().list(request).await?.into_inner();
        for dictionary in page.dictionaries {
            dictionaries.push(dictionary.try_into()?);
        }
        page_token = page.next_page_token;
        if page_token.is_empty() {
            return Ok(dictionaries);
        }
    }
}

pub(crate) fn text(dictionaries: &[DictionaryStatus]) -> String {
    if dictionaries.is_empty() {
        return "no dictionaries yet: `farmctl submit` computes one".to_owned();
    }
    let head = "dictionary | state | >priority | >records | >of | >work done | >left | >failed jobs";
    let row = |d: &DictionaryStatus| {
        vec![
            d.name.to_string(),
            state(d),
            d.priority.to_string(),
            grouped(d.records_done() as u64),
            grouped(d.records_total() as u64),
            share_of_work(d.work_done),
            d.eta_s.map_or_else(String::new, |s| duration(std::time::Duration::from_secs_f64(s))),
            d.jobs_failed.to_string(),
        ]
    };
    table(head, dictionaries.iter().map(row))
}
