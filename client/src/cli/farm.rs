//! Arguments of the commands that steer a farm.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use farm_link::Role;

use super::examples;

#[derive(Debug, Subcommand)]
pub enum AccessCommand {
    /// Create access files for the coordinator and for each role: worker, client and admin.
    #[command(after_help = examples::ACCESS_CREATE)]
    Create(AccessCreateArgs),
    /// Add a member with a token and an access file of its own; a running coordinator accepts it within a second.
    #[command(after_help = examples::ACCESS_ADD)]
    Add(AccessAddArgs),
    /// Revoke a member's access by name; a running coordinator follows within a second.
    #[command(after_help = examples::ACCESS_REVOKE)]
    Revoke(AccessRevokeArgs),
    /// List the names that are let in, with their roles.
    #[command(after_help = examples::ACCESS_LIST)]
    List(AccessFolderArgs),
}

#[derive(Debug, Args)]
pub struct AccessFolderArgs {
    /// Folder with the access files.
    #[arg(long, value_name = "DIR", default_value = "access")]
    pub folder: PathBuf,
}

#[derive(Debug, Args)]
pub struct AccessAddArgs {
    /// worker, client or admin.
    #[arg(value_parser = role)]
    pub role: Role,
    /// Name of the holder: in logs and events, of the file, and of the owner of dictionaries.
    pub name: String,
    #[command(flatten)]
    pub set: AccessFolderArgs,
}

#[derive(Debug, Args)]
pub struct AccessRevokeArgs {
    /// As `farmctl access list` shows it.
    pub name: String,
    #[command(flatten)]
    pub set: AccessFolderArgs,
}

fn role(text: &str) -> Result<Role, String> {
    Role::ALL
        .into_iter()
        .find(|r| r.as_str() == text)
        .ok_or_else(|| "worker, client or admin is needed".to_owned())
}

#[derive(Debug, Args)]
pub struct AccessCreateArgs {
    /// Folder to create; it must not exist yet.
    pub folder: PathBuf,
    /// Host name or address at which others reach the coordinator; may be given several times, and the first goes into
    /// the roles' access files.
    #[arg(long, value_name = "NAME", required = true)]
    pub host: Vec<String>,
    /// Port of the coordinator.
    #[arg(long, value_name = "N", default_value_t = 7700)]
    pub port: u16,
    /// Also give each role a certificate of its own, and require one of every client (mutual TLS).
    #[arg(long)]
    pub mutual: bool,
}

#[derive(Debug, Args)]
pub struct NameArgs {
    /// Name of the dictionary.
    pub name: String,
}

#[derive(Debug, Args)]
pub struct WaitArgs {
    /// Names of the dictionaries.
    #[arg(required = true)]
    pub names: Vec<String>,
    /// Give up after this many seconds, with exit code 6.
    #[arg(long, value_name = "SECONDS")]
    pub timeout: Option<u64>,
}

#[derive(Debug, Args)]
pub struct CancelArgs {
    /// Name of the dictionary.
    pub name: String,
    /// Reason; it is kept with the dictionary and shown with it.
    #[arg(long, value_name = "TEXT", default_value = "")]
    pub reason: String,
}

#[derive(Debug, Args)]
pub struct PriorityArgs {
    /// Name of the dictionary.
    pub name: String,
    /// From -1000 to 1000; higher goes first, 0 is the default.
    #[arg(allow_negative_numbers = true)]
    pub priority: i32,
}

#[derive(Debug, Args)]
pub struct DeleteArgs {
    /// Name of the dictionary.
    pub name: String,
    /// Confirm; nothing is deleted without this.
    #[arg(long)]
    pub yes: bool,
}

#[derive(Debug, Args)]
pub struct WorkersArgs {
    #[command(subcommand)]
    pub command: Option<WorkersCommand>,
}

#[derive(Debug, Subcommand)]
pub enum WorkersCommand {
    /// List the workers; the same as no subcommand.
    List,
    /// Let a worker finish its jobs and leave.
    #[command(after_help = examples::DRAIN)]
    Drain(DrainArgs),
    /// Readmit a machine that was fenced off, once the cause of its wrong results is found.
    #[command(after_help = examples::READMIT)]
    Readmit(ReadmitArgs),
}

#[derive(Debug, Args)]
pub struct DrainArgs {
    /// Id or label of the worker, as `farmctl workers` shows them.
    pub worker: String,
}

#[derive(Debug, Args)]
pub struct ReadmitArgs {
    /// What its worker was called, as `farmctl events` shows it, or TOKEN@ADDRESS: the name of its token and where it came
    /// from.
    pub worker: String,
}

#[derive(Debug, Args)]
pub struct EventsArgs {
    /// Show only the events of this dictionary.
    #[arg(long, value_name = "NAME")]
    pub dictionary: Option<String>,
    /// Number of events to show, counted from the newest.
    #[arg(long, short = 'n', value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub number: u32,
    /// Keep running, and show events as they happen.
    #[arg(long, short)]
    pub follow: bool,
}

#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// Recompute damaged jobs.
    #[arg(long)]
    pub repair: bool,
}

#[derive(Debug, Args)]
pub struct BackupArgs {
    /// File to write; it must not exist yet. Its checksum is written to FILE.b3.
    pub file: PathBuf,
}

#[derive(Debug, Args)]
pub struct RestoreArgs {
    /// Backup to restore; it becomes the database of the folder given by --data.
    pub file: PathBuf,
}
