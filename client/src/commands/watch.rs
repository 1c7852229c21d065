//! Following dictionaries until they have ended.

use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Result, bail};
use farm_proto::DictionaryName;
use farm_proto::status::DictionaryStatus;
use farm_proto::wire::{GetRequest, JobStates, WatchJobsRequest, WatchRequest};
use serde::Serialize;
use tonic::{Code, Streaming};

use crate::cli::{Global, WaitArgs};
use crate::connection::{Connection, Purpose, with_farm};
use crate::exit;
use crate::interrupt::{Interrupted, interrupted};
use crate::output::{DictionaryJson, Output, grouped, state};
use crate::progress::{Cells, Progress};

/// How following a dictionary ended.
pub(crate) enum End {
    /// It is done, failed or cancelled.
    Ended(Duration),
    Interrupted,
}

/// Shows progress until the dictionary has ended or somebody interrupts; its last state.
pub(crate) async fn follow(
    connection: &Connection,
    status: DictionaryStatus,
    quiet: bool,
) -> Result<(DictionaryStatus, End)> {
    let progress = Progress::new(&status, quiet);
    follow_with(connection, status, progress, None).await
}

/// The same with each job's state, where there is a terminal to show them.
async fn follow_jobs(
    connection: &Connection,
    status: DictionaryStatus,
    quiet: bool,
) -> Result<(DictionaryStatus, End)> {
    let progress = Progress::new(&status, quiet);
    let jobs = if progress.has_room() {
        let request = WatchJobsRequest { name: status.name.to_string() };
        match connection.dictionaries().watch_jobs(request).await {
            Ok(states) => Some(states.into_inner()),
            // An older coordinator.
            Err(error) if error.code() == Code::Unimplemented => None,
            Err(error) => return Err(error.into()),
        }
    } else {
        None
    };
    follow_with(connection, status, progress, jobs).await
}

async fn follow_with(
    connection: &Connection,
    mut status: DictionaryStatus,
    mut progress: Progress,
    mut jobs: Option<Streaming<JobStates>>,
) -> Result<(DictionaryStatus, End)> {
    let start = tokio::time::Instant::now();
    let name = status.name.to_string();
    let request = WatchRequest { name: name.clone() };
    let mut updates = connection.dictionaries().watch(request).await?.into_inner();
    let mut cells = Cells::new(&status.grid);
    let mut interrupt = std::pin::pin!(interrupted());
    loop {
        let update = tokio::select! {
            update = updates.message() => update?,
            run = next_run(&mut jobs) => {
                if let Some(run) = run {
                    let (first, states) = run.read()?;
                    cells.set(first, &states);
                    progress.show_cells(&cells);
                }
                continue;
            }
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
    if status.state().is_open() {
        let message =
            format!("the coordinator stopped before {name} was done: run the same command again to go on");
        return Err(tonic::Status::unavailable(message).into());
    }
    Ok((status, End::Ended(start.elapsed())))
}

/// The next states of jobs. Once there are no more it waits for ever: how the dictionary ends is told elsewhere.
async fn next_run(jobs: &mut Option<Streaming<JobStates>>) -> Option<JobStates> {
    let Some(states) = jobs else { return std::future::pending().await };
    let run = states.message().await.ok().flatten();
    if run.is_none() {
        *jobs = None;
    }
    run
}

pub(crate) async fn watch(global: &Global, name: &str, output: &Output) -> Result<ExitCode> {
    let name = DictionaryName::new(name)?;
    let (status, end) = with_farm(global, Purpose::Ask, async |connection| {
        let status = get(connection, &name).await?;
        must_progress(connection, &status)?;
        follow_jobs(connection, status, global.quiet).await
    })
    .await?;
    let code = match end {
        End::Interrupted => ExitCode::from(exit::INTERRUPTED),
        End::Ended(_) => exit::code_of(&status),
    };
    output.print("watch", &DictionaryJson::from(&status), || line(&status))?;
    Ok(code)
}

#[derive(Debug, Serialize)]
struct WaitJson {
    dictionaries: Vec<DictionaryJson>,
    timed_out: bool,
}

pub(crate) async fn wait(global: &Global, args: WaitArgs, output: &Output) -> Result<ExitCode> {
    let names: Vec<DictionaryName> =
        args.names.into_iter().map(DictionaryName::new).collect::<Result<_, _>>()?;
    let limit = Duration::from_secs(args.timeout.unwrap_or(u32::MAX.into()));
    let deadline = tokio::time::Instant::now() + limit;
    let (statuses, timed_out) = with_farm(global, Purpose::Ask, async |connection| {
        let mut statuses = Vec::new();
        let mut timed_out = false;
        for name in &names {
            let status = get(connection, name).await?;
            must_progress(connection, &status)?;
            let followed = tokio::time::timeout_at(deadline, follow(connection, status, true)).await;
            let Ok(followed) = followed else {
                timed_out = true;
                statuses.push(get(connection, name).await?);
                continue;
            };
            let (status, end) = followed?;
            if matches!(end, End::Interrupted) {
                return Err(Interrupted.into());
            }
            statuses.push(status);
        }
        Ok((statuses, timed_out))
    })
    .await?;
    let worst = statuses.iter().map(exit::number_of).max().unwrap_or(0);
    let data = WaitJson { dictionaries: statuses.iter().map(Into::into).collect(), timed_out };
    output.print("wait", &data, || statuses.iter().map(|s| format!("{}\n", line(s))).collect())?;
    Ok(ExitCode::from(if timed_out { exit::TIMEOUT } else { worst }))
}

pub(crate) async fn get(connection: &Connection, name: &DictionaryName) -> Result<DictionaryStatus> {
    let answer = connection.dictionaries().get(GetRequest { name: name.to_string() }).await?;
    Ok(answer.into_inner().try_into()?)
}

/// A coordinator that this command has just started for itself computes nothing.
fn must_progress(connection: &Connection, status: &DictionaryStatus) -> Result<()> {
    if connection.is_embedded() && status.state().is_open() {
        bail!("nothing is running in this folder: `farmctl submit` goes on with {}", status.name);
    }
    Ok(())
}

/// What there is to say of a dictionary in a line.
pub(crate) fn line(status: &DictionaryStatus) -> String {
    let (done, total) = (grouped(status.records_done() as u64), grouped(status.records_total() as u64));
    let mut line = format!("{}: {}, {done} of {total} records", status.name, state(status));
    if status.jobs_failed > 0 {
        line += &format!(", {} jobs given up", grouped(status.jobs_failed as u64));
    }
    if !status.reason.is_empty() {
        line += &format!(" ({})", status.reason);
    }
    line
}
