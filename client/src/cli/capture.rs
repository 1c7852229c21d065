//! Arguments of `capture`.

use std::path::PathBuf;

use clap::Args;

#[derive(Debug, Args)]
pub struct CaptureArgs {
    /// Session file in TOML: the photographs, and the known values of patches, board and slabs.
    #[arg(required_unless_present_any = ["check", "board"], conflicts_with_all = ["check", "board"])]
    pub session: Option<PathBuf>,
    /// Folder to write: measurements.csv, session.json, scene.toml, grid.toml, report.html, report.json [default: the
    /// session file's name without its ending].
    #[arg(long, short, value_name = "DIR", requires = "session")]
    pub output: Option<PathBuf>,
    /// Go on to measure the media, as `farmctl measure DIR` does.
    #[arg(long, requires = "session")]
    pub measure: bool,
    /// Check whether single photographs are usable; the exit code is 1 if one is not.
    #[arg(long, value_name = "SHOT", num_args = 1.., conflicts_with = "board")]
    pub check: Vec<PathBuf>,
    /// Colours of 2 × 2 pixels, row by row, for --check of mosaics whose files do not contain them.
    #[arg(long, value_name = "RGGB", requires = "check")]
    pub pattern: Option<String>,
    /// Dark shots for --check, of photographs whose files do not contain the black level (TIFF, PNG, PGM).
    #[arg(long, value_name = "SHOT", num_args = 1.., requires = "check")]
    pub darks: Vec<PathBuf>,
    /// Write a board to print: FILE.svg or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    pub board: Option<PathBuf>,
}
