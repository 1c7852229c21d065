//! Parses the command line of `farmctl` and calls the library.

#![warn(clippy::print_stdout, clippy::print_stderr, reason = "they panic where the output is full or closed")]

use std::process::ExitCode;

use farm_link::arguments;
use farm_link::logs::{self, LogFormat};

fn main() -> ExitCode {
    let cli: farmctl::Cli = arguments::parse_as(farmctl::Cli::with_help(std::env::args_os()));
    if let Err(error) = logs::init(LogFormat::Text, "error") {
        logs::to_stderr(format_args!("farmctl: {error}"));
        return ExitCode::FAILURE;
    }
    farmctl::run(cli)
}
