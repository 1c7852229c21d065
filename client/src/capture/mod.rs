//! From a session's photographs to its profiles: reads the files, runs the steps of `optics_capture`, writes the results.

mod board_sheet;
mod budget;
mod globs;
mod picture;
mod report;
mod results;
mod session_file;
mod shots;
mod stage;
mod strip;

pub(crate) use board_sheet::board_sheet;
pub(crate) use budget::{SessionErrors, error_of};
pub(crate) use report::{Simulated, ends, mean, with_fits};
pub(crate) use results::{FILES, write_folder};
#[cfg(test)]
pub(crate) use session_file::Session;
pub(crate) use session_file::pattern;
pub(crate) use shots::Shots;
pub(crate) use stage::{Captured, capture};
