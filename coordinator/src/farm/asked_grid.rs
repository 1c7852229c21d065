//! The grid that a question is about: that of a dictionary, or the same over the boards of the question, if the dictionary
//! is for all boards.

use std::sync::Arc;

use optics_model::scene::Channel;
use optics_model::{Grid, Invalid};

/// The grid of a dictionary as it is stored, and the grid of the question.
#[derive(Debug, Clone)]
pub struct AskedGrid {
    pub stored: Arc<Grid>,
    pub grid: Arc<Grid>,
}

impl AskedGrid {
    /// Over the boards of these channels; over its own if there are none.
    pub fn new(stored: Arc<Grid>, boards: Vec<Channel>) -> Result<Self, Invalid> {
        let grid = if boards.is_empty() { stored.clone() } else { Arc::new(stored.over_boards(boards)?) };
        Ok(Self { stored, grid })
    }

    pub fn is_over_others(&self) -> bool {
        !Arc::ptr_eq(&self.stored, &self.grid)
    }

    /// The boards of the question; none for the dictionary's own.
    pub fn boards(&self) -> &[Channel] {
        if self.is_over_others() { self.grid.scene().channels() } else { &[] }
    }
}
