//! `farmctl`: parses the command line and calls the library.

use std::process::ExitCode;

use clap::Parser;
use farm_link::logs;
use farm_link::logs::LogFormat;

fn main() -> ExitCode {
    let cli = farmctl::cli::Cli::parse();
    if let Err(error) = logs::init(LogFormat::Text, "error") {
        eprintln!("farmctl: {error}");
        return ExitCode::FAILURE;
    }
    farmctl::run(cli)
}
