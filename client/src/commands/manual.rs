//! Implements `farmctl manual`: writes man pages of all three programs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args, Command, CommandFactory};
use clap_mangen::Man;

use super::Cli;
use crate::output::write_whole;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl manual ~/.local/share/man/man1    then: man farmctl-measure")]
pub(crate) struct ManualArgs {
    /// Folder for the pages, created if it does not exist.
    folder: PathBuf,
}

pub(crate) fn run(args: &ManualArgs) -> Result<()> {
    let folder = &args.folder;
    std::fs::create_dir_all(folder).with_context(|| format!("folder {}", folder.display()))?;
    let mut farmctl = Cli::command();
    // The global options appear with every verb, as in --help.
    farmctl.build();
    pages(&farmctl, "farmctl", folder)?;
    pages(&farm_coordinator::cli::Args::command(), "farm-coordinator", folder)?;
    pages(&farm_worker::cli::Args::command(), "farm-worker", folder)
}

/// Writes the page of a command, and the pages of its subcommands: `farmctl-slurm-submit.1`.
fn pages(command: &Command, name: &str, folder: &Path) -> Result<()> {
    let mut page = Vec::new();
    // clap accepts only static strings as names of commands.
    let named: &'static str = name.to_owned().leak();
    Man::new(command.clone().name(named)).source("resin-farm").manual("resin-farm").render(&mut page)?;
    let file = folder.join(format!("{name}.1"));
    write_whole(&file, &page).with_context(|| format!("output {}", file.display()))?;
    for below in command.get_subcommands().filter(|c| c.get_name() != "help" && !c.is_hide_set()) {
        pages(below, &format!("{name}-{}", below.get_name()), folder)?;
    }
    Ok(())
}
