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
        let mut reasons = connection.dictionaries().explain(request).await?.into_inner().reasons;
        if connection.is_embedded() {
            reasons
                .iter_mut()
                .filter(|r| r.code == "NO_WORKERS")
                .for_each(|r| r.text = of_this_folder(&name));
        }
        Ok(reasons)
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

/// Replaces the reason for a coordinator that only this command has started: it needs no worker to be started.
fn of_this_folder(name: &DictionaryName) -> String {
    let grid = if name.as_str() == "paper" { "" } else { " with the same grid file and name" };
    format!("nothing computes in this folder at the moment: `farmctl submit`{grid} continues {name}")
}
