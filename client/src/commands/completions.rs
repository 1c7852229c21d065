use std::io::Write as _;

use anyhow::Result;
use clap::CommandFactory;

use crate::cli::{Cli, CompletionsArgs};

pub(crate) fn run(args: &CompletionsArgs) -> Result<()> {
    // clap's generator panics where the output is full or closed.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "farmctl", &mut script);
    let mut stdout = std::io::stdout();
    stdout.write_all(&script)?;
    Ok(stdout.flush()?)
}
