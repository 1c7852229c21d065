//! Implements `farmctl submit`: computes a dictionary or continues it. Other verbs use it to compute a missing one.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_lab::grid_file::{named_grid, read_grid, with_responses};
use farm_link::logs::to_stderr;
use farm_proto::DictionaryName;
use farm_proto::status::{DictionaryState, DictionaryStatus};
use farm_proto::wire::{ResumeRequest, SubmitRequest};
use optics_model::Grid;
use optics_model::grid::NoiseLevel;
use tokio::task::block_in_place;

use super::following::{self, follow};
use super::forecast::Forecast;
use super::list;
use super::watch::line;
use crate::cli::Global;
use crate::connection::{Connection, Purpose, patient, with_farm};
use crate::exit;
use crate::interrupt::Interrupted;
use crate::output::{DictionaryJson, Output, duration, grouped, is_closed_pipe};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl submit                                  compute the paper's dictionary in ./farm-data
  farmctl submit lab                              one for measurements of your own
  farmctl submit grid.toml --name fine            compute a grid of your own
  farmctl submit grid.toml --server http://farm:7700 --wait")]
pub(crate) struct SubmitArgs {
    /// Grid file in TOML, or "lab" for a laboratory's own measurements [default: the paper's grid].
    grid: Option<PathBuf>,
    /// Name of the dictionary [default: the file's name, "lab" or "paper"].
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// How quiet the records are to be: draft, paper or fine, for errors up to three times as large as the paper's, the
    /// paper's, and a third of them with ten times the walks; instead of the grid file's setting.
    #[arg(long, value_name = "LEVEL", value_parser = level)]
    quality: Option<NoiseLevel>,
    /// Wait until the dictionary is finished; without a server, submit always waits.
    #[arg(long)]
    wait: bool,
    /// Priority from -1000 to 1000; higher goes first.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true)]
    priority: i32,
}

fn level(name: &str) -> Result<NoiseLevel, String> {
    NoiseLevel::from_name(name).map_err(|invalid| invalid.allowed().to_owned())
}

pub(crate) async fn run(global: &Global, args: SubmitArgs, output: &Output) -> Result<ExitCode> {
    let (grid, default_name) = match &args.grid {
        Some(file) => match file.to_str().and_then(|name| Some((named_grid(name)?, name.to_owned()))) {
            Some(named) if !file.exists() => named,
            _ => (read_grid(file)?, stem(file)?),
        },
        None => (Grid::paper(), "paper".to_owned()),
    };
    let grid = match args.quality {
        Some(level) => grid.with_effort(level)?,
        None => grid,
    };
    let name = DictionaryName::new(args.name.clone().unwrap_or(default_name))?;
    let (status, end) = with_farm(global, Purpose::Compute, async |connection| {
        submit(connection, &name, &grid, &args, global.quiet).await
    })
    .await?;
    let code = match end {
        SubmitEnd::Left | SubmitEnd::Followed(following::FollowEnd::Interrupted) => {
            ExitCode::from(exit::INTERRUPTED)
        }
        SubmitEnd::Followed(following::FollowEnd::Ended(_)) => exit::code_of(&status),
        SubmitEnd::Submitted => ExitCode::SUCCESS,
    };
    match output.print("submit", &DictionaryJson::from(&status), || {
        if global.quiet { name.to_string() } else { text(&status, &end) }
    }) {
        // The exit code counts even if the result cannot be printed.
        Err(error) if !is_closed_pipe(&error) => Err(error),
        _ => Ok(code),
    }
}

fn stem(file: &Path) -> Result<String> {
    let stem = file.file_stem().and_then(|s| s.to_str());
    Ok(stem.with_context(|| format!("{} gives no name: add --name", file.display()))?.to_owned())
}

enum SubmitEnd {
    /// The command does not wait.
    Submitted,
    /// The command stopped waiting; another process continues the work.
    Left,
    Followed(following::FollowEnd),
}

/// Computes a dictionary if it does not exist, and waits for it. Responses that its grid lacks are planned only then, since
/// that takes a moment.
pub(crate) async fn ensure(
    connection: &Connection,
    name: &DictionaryName,
    grid: &Grid,
    quiet: bool,
) -> Result<()> {
    let args = SubmitArgs { grid: None, name: None, quality: None, wait: true, priority: 0 };
    let known = list::fetch(connection).await?.into_iter().find(|d| d.name == *name);
    let lacks_responses = grid.responses().is_none();
    match known {
        Some(d) if d.state() == DictionaryState::Paused => {
            bail!("dictionary {name} is paused: `farmctl resume {name}` continues it");
        }
        Some(d) if lacks_responses && is_done(&d, grid) => return Ok(()),
        _ => {}
    }
    let planned = if lacks_responses { Some(with_responses(grid.clone())?) } else { None };
    let (status, end) = submit(connection, name, planned.as_ref().unwrap_or(grid), &args, quiet).await?;
    match (&end, status.state()) {
        (SubmitEnd::Followed(following::FollowEnd::Ended(_)), DictionaryState::Done) => Ok(()),
        (SubmitEnd::Left | SubmitEnd::Followed(following::FollowEnd::Interrupted), _) => {
            Err(Interrupted.into())
        }
        _ => bail!("the dictionary was not computed: {}", text(&status, &end)),
    }
}

/// Whether a dictionary is complete and has this grid, apart from responses.
fn is_done(known: &DictionaryStatus, grid: &Grid) -> bool {
    known.state() == DictionaryState::Done && known.grid.clone().without_responses() == *grid
}

/// Whether nothing of a grid is left to compute.
async fn is_ended(connection: &Connection, name: &DictionaryName, grid: &Grid) -> bool {
    let known = following::get(connection, name).await;
    known.is_ok_and(|known| known.state() == DictionaryState::Done && known.grid == *grid)
}

async fn submit(
    connection: &Connection,
    name: &DictionaryName,
    grid: &Grid,
    args: &SubmitArgs,
    quiet: bool,
) -> Result<(DictionaryStatus, SubmitEnd)> {
    let is_wanted = connection.is_embedded() && !quiet && !is_ended(connection, name, grid).await;
    // This command's worker begins with the submission, and would slow the jobs that are timed.
    let forecast = is_wanted.then(|| block_in_place(|| Forecast::new(grid)));
    let request = SubmitRequest { name: name.to_string(), grid: Some(grid.into()), priority: args.priority };
    let submitted = connection.dictionaries().submit(patient(request)).await?.into_inner();
    let mut status = DictionaryStatus::try_from(submitted)?;
    if status.is_interrupted() {
        let resume = ResumeRequest { name: name.to_string() };
        status = connection.dictionaries().resume(resume).await?.into_inner().try_into()?;
    }
    if !args.wait && connection.is_server() {
        return Ok((status, SubmitEnd::Submitted));
    }
    if let Some(forecast) = forecast.filter(|_| status.state() == DictionaryState::Running) {
        to_stderr(format_args!("farmctl: {}", forecast.text(&status)));
    }
    match follow(connection, &mut status, quiet).await? {
        following::FollowEnd::Interrupted if !connection.is_embedded() => Ok((status, SubmitEnd::Left)),
        end => Ok((status, SubmitEnd::Followed(end))),
    }
}

fn text(status: &DictionaryStatus, end: &SubmitEnd) -> String {
    let name = &status.name;
    let (done, total) = (grouped(status.records_done() as u64), grouped(status.records_total() as u64));
    match end {
        SubmitEnd::Submitted => format!("{name}: {total} records are to be computed, {done} are done"),
        SubmitEnd::Left => format!(
            "{name}: {done} of {total} records are done, and the farm continues: `farmctl watch {name}` to \
             look again, `farmctl cancel {name}` to stop"
        ),
        SubmitEnd::Followed(following::FollowEnd::Interrupted) => {
            format!("{name}: stopped, {done} of {total} records are stored; submit again to continue")
        }
        SubmitEnd::Followed(following::FollowEnd::Ended(elapsed))
            if status.state() == DictionaryState::Done =>
        {
            let digest = status.records_digest.map(|d| d.to_string()).unwrap_or_default();
            let disputed = match status.jobs_disputed {
                0 => String::new(),
                n => format!("\n{n} jobs are disputed: see `farmctl explain {name}`"),
            };
            format!(
                "{name}: {total} records are done, in {}{disputed}\nrecords digest {digest}",
                duration(*elapsed)
            )
        }
        SubmitEnd::Followed(following::FollowEnd::Ended(_))
            if status.state() == DictionaryState::Cancelled =>
        {
            line(status)
        }
        SubmitEnd::Followed(following::FollowEnd::Ended(_)) => {
            let reasons = status.failed.iter().map(|f| format!("\n  job {}: {}", f.job, f.reason));
            format!(
                "{name}: {done} of {total} records are done, {} jobs failed{}",
                status.jobs_failed,
                reasons.collect::<String>()
            )
        }
    }
}
