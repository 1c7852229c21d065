//! Implements `farmctl completions`: prints the completion script of a shell.

use std::io::Write as _;

use anyhow::Result;
use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::Cli;

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  farmctl completions bash > ~/.local/share/bash-completion/completions/farmctl")]
pub(crate) struct CompletionsArgs {
    shell: Shell,
}

pub(crate) fn run(args: &CompletionsArgs) -> Result<()> {
    // clap's generator panics where the output is full or closed.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "farmctl", &mut script);
    let mut stdout = std::io::stdout();
    stdout.write_all(&script)?;
    Ok(stdout.flush()?)
}
