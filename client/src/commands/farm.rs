//! Commands that run, watch and maintain a farm.

pub(crate) mod access;
pub(crate) mod backup;
pub(crate) mod doctor;
pub(crate) mod events;
pub(crate) mod health;
pub(crate) mod serve;
pub(crate) mod status;
pub(crate) mod workers;

use std::process::ExitCode;

use anyhow::Result;
use clap::Subcommand;

use crate::cli::Global;
use crate::output::Output;

#[derive(Debug, Subcommand)]
pub(crate) enum FarmCommand {
    /// Keep the farm of a folder running, for notebooks and other programs on this machine.
    Serve(serve::ServeArgs),
    /// Show what the farm is doing.
    #[command(after_help = "\
Examples:
  farmctl status
  farmctl status --server http://farm:7700 --json")]
    Status,
    /// List the workers, or ask one to leave.
    Workers(workers::WorkersArgs),
    /// Show what has happened on the farm.
    Events(events::EventsArgs),
    /// Check everything: connection, versions, disk and every record.
    Doctor(doctor::DoctorArgs),
    /// Copy the whole database to a file and verify the copy, while the farm keeps running.
    Backup(backup::BackupArgs),
    /// Restore a backup into a folder that has no database yet.
    Restore(backup::RestoreArgs),
    /// Check whether the coordinator is serving; meant for health checks.
    #[command(after_help = "\
Examples:
  farmctl health --server http://127.0.0.1:7700
  farmctl health --access client.toml --quiet")]
    Health,
    /// Create the access files for the coordinator, the workers and people.
    #[command(subcommand)]
    Access(access::AccessCommand),
}

impl FarmCommand {
    pub(crate) async fn run(self, global: &Global, output: &Output) -> Result<ExitCode> {
        match self {
            Self::Serve(args) => serve::run(global, &args, output).await?,
            Self::Status => status::run(global, output).await?,
            Self::Workers(args) => workers::run(global, args, output).await?,
            Self::Events(args) => events::run(global, args, output).await?,
            Self::Doctor(args) => return doctor::run(global, &args, output).await,
            Self::Backup(args) => backup::backup(global, args, output).await?,
            Self::Restore(args) => backup::restore(global, args, output).await?,
            Self::Health => health::run(global, output).await?,
            Self::Access(command) => access::run(command, output)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}
