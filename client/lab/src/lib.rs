//! Reads and writes a laboratory's files: photographs and sessions, measurements, grids, scenes and mixtures.
//!
//! Checks them, runs `optics_capture` on photographs, and writes the results. It uses no network and no async runtime.
//!
//! `docs/glossary.md` explains the terms.

mod bounded_file;
pub mod capture;
pub mod chart;
pub mod colour;
pub mod document;
mod file_kind;
pub mod grid_file;
pub mod measurement_file;
pub mod media_file;
pub mod mixture_file;
mod number_table;
pub mod phase_file;
pub mod photograph;
pub mod record;
pub mod research_object;
pub mod session_folder;
pub mod set_up;
pub mod slab_grid;
pub mod slabs;
pub mod uncertainty;
pub mod whole_file;
