//! Commands that compute, follow, list, show and export dictionaries.

mod data;
pub(crate) mod explain;
pub(crate) mod export;
mod following;
mod forecast;
pub(crate) mod list;
pub(crate) mod manage;
pub(crate) mod show;
pub(crate) mod submit;
pub(crate) mod watch;

pub(crate) use following::DictionaryDeleted;

use std::process::ExitCode;

use anyhow::Result;
use clap::Subcommand;

use crate::cli::{Global, NameArgs};
use crate::output::Output;

#[derive(Debug, Subcommand)]
pub(crate) enum DictionaryCommand {
    /// Compute a dictionary; if it exists with the same grid, carry on with it.
    Submit(submit::SubmitArgs),
    /// List the dictionaries.
    #[command(after_help = "\
Examples:
  farmctl list
  farmctl list --data /scratch/farm-data")]
    List,
    /// List what takes room, and delete what will not be finished.
    Data(data::DataArgs),
    /// Show the details of a dictionary.
    Show(show::ShowArgs),
    /// Follow the progress of a dictionary until it ends; the exit code is that of its end.
    #[command(after_help = "\
Example:
  farmctl watch paper                             Ctrl-C ends the view, not the work")]
    Watch(NameArgs),
    /// Wait silently until dictionaries have ended; the exit code is that of their end.
    Wait(watch::WaitArgs),
    /// Explain why a dictionary is not finished yet.
    #[command(after_help = "\
Example:
  farmctl explain paper")]
    Explain(NameArgs),
    /// Stop handing out jobs of a dictionary; jobs already running are finished.
    #[command(after_help = "\
Example:
  farmctl pause paper                             `farmctl resume paper` carries on")]
    Pause(NameArgs),
    /// Resume a dictionary that was paused or cancelled.
    #[command(after_help = "\
Example:
  farmctl resume paper")]
    Resume(NameArgs),
    /// Cancel a dictionary; finished records are kept.
    Cancel(manage::CancelArgs),
    /// Retry the jobs of a dictionary that were given up.
    #[command(after_help = "\
Example:
  farmctl retry paper                             `farmctl show paper` lists the failed jobs and their errors")]
    Retry(NameArgs),
    /// Set the priority of a dictionary.
    Priority(manage::PriorityArgs),
    /// Delete a dictionary and the records that no other dictionary uses.
    Delete(manage::DeleteArgs),
    /// Export the finished records of a dictionary as CSV.
    Export(export::ExportArgs),
}

impl DictionaryCommand {
    pub(crate) async fn run(self, global: &Global, output: &Output) -> Result<ExitCode> {
        match self {
            Self::Submit(args) => return submit::run(global, args, output).await,
            Self::List => list::run(global, output).await?,
            Self::Data(args) => data::run(global, &args, output).await?,
            Self::Show(args) => show::run(global, args, output).await?,
            Self::Watch(args) => return watch::watch(global, &args.name, output).await,
            Self::Wait(args) => return watch::wait(global, args, output).await,
            Self::Explain(args) => explain::run(global, &args.name, output).await?,
            Self::Pause(args) => manage::pause(global, &args.name, output).await?,
            Self::Resume(args) => manage::resume(global, &args.name, output).await?,
            Self::Cancel(args) => manage::cancel(global, args, output).await?,
            Self::Retry(args) => manage::retry(global, &args.name, output).await?,
            Self::Priority(args) => manage::priority(global, args, output).await?,
            Self::Delete(args) => manage::delete(global, args, output).await?,
            Self::Export(args) => export::run(global, args, output).await?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
