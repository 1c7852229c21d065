//! Arguments that several verbs share.

mod bounds;
mod figure;
pub(crate) mod help;
mod options;
pub(crate) mod set_up;
mod whole;

use std::path::PathBuf;

use clap::Args;

pub(crate) use figure::FigureArgs;
pub(crate) use options::{MuArgs, OptionArgs};
pub(crate) use set_up::SetUpArgs;
pub(crate) use whole::whole_number;

#[derive(Debug, Clone, Args)]
pub(crate) struct Global {
    /// URL of the coordinator, such as http://farm:7700.
    #[arg(long, value_name = "URL", env = "FARM_SERVER", global = true, help_heading = "General options")]
    pub(crate) server: Option<String>,
    /// Access file for the coordinator: its URL, its certificate and a token.
    #[arg(long, value_name = "FILE", env = "FARM_ACCESS", global = true, help_heading = "General options")]
    pub(crate) access: Option<PathBuf>,
    /// Run in this process even if a server is configured.
    #[arg(long, global = true, help_heading = "General options")]
    pub(crate) local: bool,
    /// Folder for the local farm's data.
    #[arg(
        long,
        value_name = "DIR",
        env = "FARM_DATA",
        default_value = "farm-data",
        global = true,
        help_heading = "General options"
    )]
    pub(crate) data: PathBuf,
    /// Print a single JSON object instead of text.
    #[arg(long, global = true, help_heading = "General options")]
    pub(crate) json: bool,
    /// Show no progress on standard error.
    #[arg(long, short, global = true, help_heading = "General options")]
    pub(crate) quiet: bool,
}

#[derive(Debug, Args)]
pub(crate) struct NameArgs {
    /// Name of the dictionary.
    pub(crate) name: String,
}
