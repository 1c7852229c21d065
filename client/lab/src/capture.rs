//! Turns a session's photographs into profiles: reads the files, runs the steps of `optics_capture`, writes the results.

mod band_optics;
mod bands;
mod board_sheet;
mod budget;
mod captured;
mod channels;
mod globs;
mod in_gel;
mod new_session;
mod picture;
mod report;
mod results;
mod session_file;
mod shots;
mod spectrum;
mod stage;
mod strip;

pub use board_sheet::board_sheet;
pub use budget::SessionErrors;
pub use captured::{Captured, CapturedPart, CapturedSample};
pub use channels::CapturedChannel;
pub use new_session::{Purpose, SESSION, SortedFolder, holds_photographs, is_photograph, sort_folder};
pub use report::{
    CaptureReport, CapturedRow, MeasureVerdict, Media, PrecisionRow, Simulated, budget_blocks, captured_rows,
    captured_table, estimate_blocks,
};
pub use results::{FILES, write_folder};
pub use session_file::CaptureSession;
pub use session_file::pattern;
pub use shots::Shots;
pub use stage::capture;
