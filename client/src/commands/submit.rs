use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::{SubmitRequest, WatchRequest};
use farm_proto::{DictionaryName, Grid};

use crate::cli::{Global, SubmitArgs};
use crate::connection::{Connection, Purpose, with_farm};
use crate::grid_file::read_grid;
use crate::output::{DictionaryJson, Output, duration, grouped, is_closed_pipe};
use crate::progress::Progress;

const INTERRUPTED: u8 = 130;
const JOBS_FAILED: u8 = 3;

pub(crate) async fn run(global: &Global, args: SubmitArgs, output: &Output) -> Result<ExitCode> {
    let (grid, default_name) = match &args.grid {
        Some(file) => (read_grid(file)?, stem(file)?),
        None => (Grid::paper(), "paper".to_owned()),
    };
    let name = DictionaryName::new(args.name.unwrap_or(default_name))?;
    let (status, end) = with_farm(global, Purpose::Compute, async |connection| {
        submit(connection, &name, &grid, args.wait, global.quiet).await
    })
    .await?;
    let code = match end {
        End::Interrupted => ExitCode::from(INTERRUPTED),
        End::Ended(_) if status.state() == DictionaryState::Failed => ExitCode::from(JOBS_FAILED),
        End::Ended(_) | End::Submitted => ExitCode::SUCCESS,
    };
    match output.print("submit", &DictionaryJson::from(&status), || text(&status, &end)) {
        // Whoever does not read the result still wants the exit code.
        Err(error) if !is_closed_pipe(&error) => Err(error),
        _ => Ok(code),
    }
}

fn stem(file: &Path) -> Result<String> {
    let stem = file.file_stem().and_then(|s| s.to_str());
    Ok(stem.with_context(|| format!("{} gives no name: add --name", file.display()))?.to_owned())
}

enum End {
    /// Not waited for.
    Submitted,
    /// Waited for until it was done or failed.
    Ended(std::time::Duration),
    Interrupted,
}

async fn submit(
    connection: &Connection,
    name: &DictionaryName,
    grid: &Grid,
    wait: bool,
    quiet: bool,
) -> Result<(DictionaryStatus, End)> {
    let request = SubmitRequest { name: name.to_string(), grid: Some(grid.into()) };
    let submitted = connection.dictionaries().submit(request).await?.into_inner();
    let mut status = DictionaryStatus::try_from(submitted)?;
    if !wait && connection.is_server() {
        return Ok((status, End::Submitted));
    }
    let start = tokio::time::Instant::now();
    let mut progress = Progress::new(&status, quiet);
    let mut updates =
        connection.dictionaries().watch(WatchRequest { name: name.to_string() }).await?.into_inner();
    let mut interrupt = std::pin::pin!(interrupted());
    loop {
        let update = tokio::select! {
            update = updates.message() => update?,
            () = &mut interrupt => {
                progress.end();
                return Ok((status, End::Interrupted));
            }
        };
        let Some(update) = update else { break };
        status = update.try_into()?;
        progress.show(&status);
    }
    progress.end();
    if status.state() == DictionaryState::Running {
        let message =
            format!("the coordinator stopped before {name} was done: run the same command again to go on");
        return Err(tonic::Status::unavailable(message).into());
    }
    Ok((status, End::Ended(start.elapsed())))
}

/// Ends when the process is asked to stop.
async fn interrupted() {
    use tokio::signal::unix::{SignalKind, signal};
    match signal(SignalKind::terminate()) {
        Ok(mut terminate) => tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = terminate.recv() => {}
        },
        Err(_) => {
            let _ = tokio::signal::ctrl_c().await;
        }
    }
}

fn text(status: &DictionaryStatus, end: &End) -> String {
    let name = &status.name;
    let (done, total) = (grouped(status.records_done() as u64), grouped(status.records_total() as u64));
    match end {
        End::Submitted => format!("{name}: {total} records are to be computed, {done} are done"),
        End::Interrupted => {
            format!("{name}: stopped, {done} of {total} records are stored; submit again to go on")
        }
        End::Ended(elapsed) if status.state() == DictionaryState::Done => {
            let digest = status.records_digest.map(|d| d.to_string()).unwrap_or_default();
            format!("{name}: {total} records are done, in {}\nrecords digest {digest}", duration(*elapsed))
        }
        End::Ended(_) => {
            let reasons = status.failed.iter().map(|f| format!("\n  job {}: {}", f.job, f.reason));
            format!(
                "{name}: {done} of {total} records are done, {} jobs failed{}",
                status.failed.len(),
                reasons.collect::<String>()
            )
        }
    }
}
