//! Finds the lattice of black and white squares in a photograph: its edges, its pose, the edge in use, and the light of
//! the squares that are not covered by the slab.

use optics_model::Invalid;

use crate::refusal::Side;

mod blurs;
mod cells;
mod edge;
mod field;
mod find;
pub(crate) mod light;
mod lines;
pub(crate) mod movement;
mod own_edge;
mod patch;
mod pose;
mod scan;

pub(crate) use cells::CropCells;
pub use edge::EdgeLine;
pub(crate) use edge::{EdgeFrame, HALF_CROP_MM};
pub(crate) use field::{BOARD_SLOPE, fields};
pub use find::FreeEdge;
pub(crate) use find::{LocatedBoard, find, free_edges, free_length_px};
pub(crate) use movement::FreeParts;
pub(crate) use own_edge::own_edge;
pub(crate) use patch::PatchRadiance;

/// Properties of the printed board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    pub square_mm: f64,
    pub square_std_error_mm: f64,
    /// Dark side of the edge in use; without it, the edge nearest to the frame's middle is used.
    pub dark_side: Option<Side>,
}

impl Target {
    pub(crate) fn check(&self) -> Result<(), Invalid> {
        if !(1.0..=1000.0).contains(&self.square_mm) {
            return Err(Invalid::new("square_mm", self.square_mm, "from 1 to 1000"));
        }
        if !(0.0..=0.05 * self.square_mm).contains(&self.square_std_error_mm) {
            let allowed = "from 0 to a twentieth of square_mm";
            return Err(Invalid::new("square_std_error_mm", self.square_std_error_mm, allowed));
        }
        Ok(())
    }
}
