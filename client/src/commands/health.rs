use anyhow::Result;
use farm_proto::wire::StatusRequest;
use serde::Serialize;

use crate::cli::Global;
use crate::connection::{Purpose, with_farm};
use crate::output::Output;

#[derive(Debug, Serialize)]
struct HealthJson {
    serving: bool,
    version: String,
}

pub(crate) async fn run(global: &Global, output: &Output) -> Result<()> {
    let version = with_farm(global, Purpose::Ask, async |connection| {
        Ok(connection.farm().status(StatusRequest {}).await?.into_inner().version)
    })
    .await?;
    output.print("health", &HealthJson { serving: true, version: version.clone() }, || {
        format!("serving, version {version}")
    })
}
