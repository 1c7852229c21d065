//! Arguments of the commands that steer a farm.

use std::path::PathBuf;

use clap::{Args, Subcommand};

#[derive(Debug, Subcommand)]
pub enum AccessCommand {
    /// Write access files for the coordinator and for each role: worker, client, admin.
    Create(AccessCreateArgs),
}

#[derive(Debug, Args)]
pub struct AccessCreateArgs {
    /// Folder to write them to; it must not exist.
    pub folder: PathBuf,
    /// Name or address by which others reach the coordinator; can be given several times, the first one goes into the
    /// files of the roles.
    #[arg(long, value_name = "NAME", required = true)]
    pub host: Vec<String>,
    /// Port of the coordinator.
    #[arg(long, value_name = "N", default_value_t = 7700)]
    pub port: u16,
    /// Give each role a certificate of its own too, without which nobody can connect.
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
    /// Why; kept, and told to whoever asks.
    #[arg(long, value_name = "TEXT", default_value = "")]
    pub reason: String,
}

#[derive(Debug, Args)]
pub struct PriorityArgs {
    /// Name of the dictionary.
    pub name: String,
    /// -1000 to 1000; higher goes first, 0 is usual.
    #[arg(allow_negative_numbers = true)]
    pub priority: i32,
}

#[derive(Debug, Args)]
pub struct DeleteArgs {
    /// Name of the dictionary.
    pub name: String,
    /// Do it; nothing is deleted without this.
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
    /// List them; the same as no subcommand.
    List,
    /// Let a worker finish what it has and end.
    Drain(DrainArgs),
}

#[derive(Debug, Args)]
pub struct DrainArgs {
    /// Id or label of the worker, as `farmctl workers` shows them.
    pub worker: String,
}

#[derive(Debug, Args)]
pub struct EventsArgs {
    /// Only those of this dictionary.
    #[arg(long, value_name = "NAME")]
    pub dictionary: Option<String>,
    /// How many, the newest.
    #[arg(long, short = 'n', value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub number: u32,
    /// Go on as they happen.
    #[arg(long, short)]
    pub follow: bool,
}

#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// Compute damaged jobs again.
    #[arg(long)]
    pub repair: bool,
}

#[derive(Debug, Args)]
pub struct BackupArgs {
    /// File to write; it must not exist. Its checksum goes beside it, as FILE.b3.
    pub file: PathBuf,
}

#[derive(Debug, Args)]
pub struct RestoreArgs {
    /// The backup. It becomes the database of the folder that --data names.
    pub file: PathBuf,
}
