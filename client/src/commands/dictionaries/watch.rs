//! Waits for dictionaries until they have ended.

use std::process::{ExitCode, Stdio};
use std::time::Duration;

use anyhow::{Result, bail};
use clap::Args;
use farm_link::logs::to_stderr;
use farm_proto::DictionaryName;
use farm_proto::status::DictionaryStatus;
use serde::Serialize;

use super::following::{Fixed, FollowEnd, follow, follow_jobs, get};
use crate::cli::Global;
use crate::connection::{Connection, Purpose, with_farm};
use crate::exit;
use crate::interrupt::Interrupted;
use crate::output::{DictionaryJson, Output, grouped, state};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl wait paper fine
  farmctl wait paper --timeout 3600
  farmctl wait paper --notify 'notify-send \"$FARM_MESSAGE\"'

The command of --notify has FARM_DICTIONARY, FARM_STATE (done, failed, cancelled, …) and FARM_MESSAGE in its
environment.")]
pub(crate) struct WaitArgs {
    /// Names of the dictionaries.
    #[arg(required = true)]
    names: Vec<String>,
    /// Give up after this many seconds, with exit code 6.
    #[arg(long, value_name = "SECONDS")]
    timeout: Option<u64>,
    /// Run a shell command for each dictionary when it has ended.
    #[arg(long, value_name = "COMMAND")]
    notify: Option<String>,
}

pub(crate) async fn watch(global: &Global, name: &str, output: &Output) -> Result<ExitCode> {
    let name = DictionaryName::new(name)?;
    let fixed = Fixed::default();
    let (status, end) = with_farm(global, Purpose::Ask, async |connection| {
        let mut status = fixed.get(connection, &name).await?;
        must_progress(connection, &status)?;
        let end = follow_jobs(connection, &mut status, global.quiet).await?;
        Ok((status, end))
    })
    .await?;
    let code = match end {
        FollowEnd::Interrupted => ExitCode::from(exit::INTERRUPTED),
        FollowEnd::Ended(_) => exit::code_of(&status),
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
        args.names.iter().cloned().map(DictionaryName::new).collect::<Result<_, _>>()?;
    let limit = Duration::from_secs(args.timeout.unwrap_or(u32::MAX.into()));
    let deadline = tokio::time::Instant::now() + limit;
    let fixed = Fixed::default();
    let (statuses, timed_out) = with_farm(global, Purpose::Ask, async |connection| {
        let mut statuses = Vec::new();
        for name in &names {
            let status = fixed.get(connection, name).await?;
            must_progress(connection, &status)?;
            statuses.push(status);
        }
        let mut timed_out = false;
        for status in &mut statuses {
            let followed = tokio::time::timeout_at(deadline, follow(connection, status, true)).await;
            let Ok(followed) = followed else {
                timed_out = true;
                look_again(connection, status).await;
                continue;
            };
            if matches!(followed?, FollowEnd::Interrupted) {
                return Err(Interrupted.into());
            }
            if let Some(command) = &args.notify {
                notify(command, status).await;
            }
        }
        Ok((statuses, timed_out))
    })
    .await?;
    let worst = statuses.iter().map(exit::number_of).max().unwrap_or(0);
    let data = WaitJson { dictionaries: statuses.iter().map(Into::into).collect(), timed_out };
    output.print("wait", &data, || statuses.iter().map(|s| format!("{}\n", line(s))).collect())?;
    Ok(ExitCode::from(if timed_out { exit::TIMEOUT } else { worst }))
}

/// Runs the command about a dictionary that has ended. Its failure is reported, and does not change the exit code, which is
/// about the dictionaries.
async fn notify(command: &str, status: &DictionaryStatus) {
    let mut shell = tokio::process::Command::new("sh");
    shell.arg("-c").arg(command).stdin(Stdio::null()).stdout(Stdio::null());
    shell.env("FARM_DICTIONARY", status.name.as_str()).env("FARM_STATE", state(status));
    let failure = match shell.env("FARM_MESSAGE", line(status)).status().await {
        Ok(ended) if ended.success() => return,
        Ok(ended) => ended.to_string(),
        Err(error) => error.to_string(),
    };
    to_stderr(format_args!("farmctl: the command of --notify failed for {}: {failure}", status.name));
}

/// Updates a state, unless the answer takes too long.
async fn look_again(connection: &Connection, status: &mut DictionaryStatus) {
    const AT_ONCE: Duration = Duration::from_secs(2);
    let name = status.name.clone();
    if let Ok(Ok(now)) = tokio::time::timeout(AT_ONCE, get(connection, &name)).await
        && now.grid_digest == status.grid_digest
    {
        *status = now;
    }
}

/// Refuses to wait for a coordinator that only this command has started, since it computes nothing.
fn must_progress(connection: &Connection, status: &DictionaryStatus) -> Result<()> {
    if connection.is_embedded() && status.state().is_open() {
        bail!("nothing is running in this folder: `farmctl submit` continues {}", status.name);
    }
    Ok(())
}

/// A dictionary in one line.
pub(crate) fn line(status: &DictionaryStatus) -> String {
    let (done, total) = (grouped(status.records_done() as u64), grouped(status.records_total() as u64));
    let mut line = format!("{}: {}, {done} of {total} records", status.name, state(status));
    if status.jobs_failed > 0 {
        line += &format!(", {} jobs given up", grouped(status.jobs_failed as u64));
    }
    if status.is_interrupted() {
        line += " (the same command again continues it)";
    } else if !status.reason.is_empty() {
        line += &format!(" ({})", status.reason);
    }
    line
}
