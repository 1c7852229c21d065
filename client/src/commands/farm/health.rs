//! Queries the coordinator's health service, which needs no token.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use farm_link::{ClientAccess, Target};
use serde::Serialize;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use crate::cli::Global;
use crate::connection::in_plain_words;
use crate::output::Output;

/// Deadline of a health check, which must answer quickly.
const PATIENCE: Duration = Duration::from_secs(8);

#[derive(Debug, Serialize)]
struct HealthJson {
    serving: bool,
    server: String,
}

pub(crate) async fn run(global: &Global, output: &Output) -> Result<()> {
    ensure!(
        global.server.is_some() || global.access.is_some(),
        "name the coordinator with --server or --access: a farm in this process is as healthy as the process"
    );
    let access = global.access.as_deref().map(ClientAccess::read).transpose()?;
    let target = Target::new(access.as_ref(), global.server.as_deref())?;
    let url = target.url().to_owned();
    let answer = tokio::time::timeout(PATIENCE, async {
        let mut client = HealthClient::new(target.connect_lazy());
        client.check(HealthCheckRequest { service: String::new() }).await
    });
    let answer = answer.await.with_context(|| format!("{url}: no answer within {} s", PATIENCE.as_secs()))?;
    let answer = answer.map_err(|status| in_plain_words(status.into(), &url))?;
    let status = answer.into_inner().status();
    ensure!(status == ServingStatus::Serving, "the coordinator at {url} is not serving");
    let data = HealthJson { serving: true, server: url };
    output.print("health", &data, || {
        if global.quiet { String::new() } else { format!("{} is serving", data.server) }
    })
}
