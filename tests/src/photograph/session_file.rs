//! Writes session files for simulated photographs.

use std::fmt::Write as _;

use super::session::Session;

/// Values of board, patches and slabs in a session file.
#[derive(Debug, Clone, Copy)]
pub struct SessionValues<'a> {
    pub square_mm: f64,
    pub square_std_error_mm: f64,
    /// Relative error of the patches.
    pub white_std_error: f64,
    pub thickness_mm: &'a [f64],
    pub thickness_std_error_mm: f64,
}

/// The session file of photographs with the names `dark_1` …, `flat_1`, `chart_1`, `board_1`, and `slab0_1` … of each slab.
///
/// # Panics
/// Never.
#[must_use]
pub fn session_file(session: &Session, values: &SessionValues<'_>) -> String {
    let mut text = format!(
        "[camera]\ndark = [\"dark_*\"]\nflat = [\"flat_*\"]\n\n\
         [neutral]\nshots = [\"chart_*\"]\nrho = {:?}\nstd_error = {}\ngeometry = \"own\"\nareas_px = {:?}\n\n\
         [target]\nbare = [\"board_*\"]\nsquare_mm = {}\nsquare_std_error_mm = {}\ndark_side = \"left\"\n",
        session.rho,
        values.white_std_error,
        session.areas_px(),
        values.square_mm,
        values.square_std_error_mm,
    );
    for (i, thickness_mm) in values.thickness_mm.iter().enumerate() {
        write!(
            text,
            "\n[[sample]]\nmaterial = \"resin\"\nthickness_mm = {thickness_mm}\n\
             thickness_std_error_mm = {}\nshots = [\"slab{i}_*\"]\n",
            values.thickness_std_error_mm
        )
        .expect("memory takes it");
    }
    text
}
