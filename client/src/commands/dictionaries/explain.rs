//! Implements `farmctl explain`: prints the reasons why a dictionary is not finished.

use anyhow::Result;
use farm_proto::DictionaryName;
use farm_proto::wire::ExplainRequest;
use serde::Serialize;

use crate::cli::Global;
use crate::connection::{Purpose, with_farm};
use crate::output::Output;

#[derive(Debug, Serialize)]
struct ExplainJson {
    name: String,
    reasons: Vec<ReasonJson>,
}

#[derive(Debug, Serialize)]
struct ReasonJson {
    code: String,
    text: String,
}

pub(crate) async fn run(global: &Global, name: &str, output: &Output) -> Result<()> {
    let name = DictionaryName::new(name)?;
    let reasons = with_farm(global, Purpose::Ask, async |connection| {
        let request = ExplainRequest { name: name.to_string() };
        Ok(connection.dictionaries().explain(request).await?.into_inner().reasons)
    })
    .await?;
    let data = ExplainJson {
        name: name.to_string(),
        reasons: reasons.into_iter().map(|r| ReasonJson { code: r.code, text: r.text }).collect(),
    };
    output.print("explain", &data, || {
        data.reasons.iter().fold(format!("{name}:\n"), |text, r| text + &format!("  {}\n", r.text))
    })
}
